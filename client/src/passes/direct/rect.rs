//! Irradiance from rectangles on the processor; twin of `shared/rect.wgsl`, function by function.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};

use super::reference::{cube_face, face_of, share_by};
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{Light, RECT_FACES, ShadowPlan};

/// Diagonals of a cell beyond which it counts as a point.
const FAR: f32 = 64.0;

/// Part of an edge between two points, seen from the origin: θ n·(a × b)/|a × b|, θ being the angle between them.
fn edge_part(a: Vec3, b: Vec3, normal: Vec3) -> f32 {
    let [of_a, of_b] = [a, b].map(|point| 1.0 / point.length_squared().max(1e-30).sqrt());
    let scale = of_a * of_b;
    let across = a.cross(b - a) * scale;
    let cosine = a.dot(b) * scale;
    let sine2 = across.length_squared();
    // θ / sin θ by x = sin²(θ/2); beyond a right angle by π − θ.
    let x = 0.5 * sine2 / (1.0 + cosine.abs());
    let series = 1.0
        + x * (0.6663532
            + x * (0.5452078 + x * (0.3105367 + x * (1.209364 + x * (-1.711025 + x * 2.584307)))));
    let ratio = if cosine < 0.0 { PI / sine2.max(1e-30).sqrt() - series } else { series };
    normal.dot(across) * ratio
}

/// ∫ cosθ dω over a rectangle of half sides u and v before a surface at the origin, above its horizon: Lambert's formula.
pub(in crate::passes) fn rect_factor(middle: Vec3, u: Vec3, v: Vec3, normal: Vec3) -> f32 {
    let distance2 = middle.length_squared();
    if distance2 > FAR * FAR * 4.0 * (u.length_squared() + v.length_squared()) {
        let facing = 4.0 * u.cross(v).dot(middle).abs();
        return normal.dot(middle).max(0.0) * facing / (distance2 * distance2);
    }
    let corners = [middle - u - v, middle + u - v, middle + u + v, middle - u + v];
    let (mut sum, mut is_cut) = (0.0, false);
    let [mut leaves, mut enters] = [Vec3::ZERO; 2];
    for (index, corner) in corners.into_iter().enumerate() {
        let (mut start, mut end) = (corner, corners[(index + 1) % 4]);
        let heights = [start, end].map(|point| point.dot(normal));
        if heights[0].max(heights[1]) <= 0.0 {
            is_cut = true;
            continue;
        }
        let crossing = start + (end - start) * (heights[0] / (heights[0] - heights[1]));
        if heights[0] <= 0.0 {
            (start, enters, is_cut) = (crossing, crossing, true);
        }
        if heights[1] <= 0.0 {
            (end, leaves, is_cut) = (crossing, crossing, true);
        }
        sum += edge_part(start, end, normal);
    }
    if is_cut {
        // Along the horizon.
        sum += edge_part(leaves, enters, normal);
    }
    (0.5 * sum).max(0.0)
}

/// Number of the face of half a cube that holds a vector from its middle.
pub(super) fn half_cube_face(plan: &ShadowPlan, light: &Light, d: Vec3) -> u32 {
    let front = &plan.faces[(light.first_face + RECT_FACES - 1) as usize];
    let along = d.dot(light.direction.into()).max(0.0);
    cube_face(Vec3::new(d.dot(front.right.into()), d.dot(front.up.into()), along))
}

/// A cell of a rectangle.
struct Cell {
    /// The cell as a light, whose faces stand before its middle.
    light: Light,
    /// Half sides.
    sides: [Vec3; 2],
}

/// The cells of a rectangle.
fn cells(plan: &ShadowPlan, light: &Light) -> impl Iterator<Item = Cell> {
    let front = &plan.faces[(light.first_face + RECT_FACES - 1) as usize];
    let [columns, rows] = light.cells;
    let u = Vec3::from(front.right) * (light.half_size_m[0] / columns as f32);
    let v = Vec3::from(front.up) * (light.half_size_m[1] / rows as f32);
    let light = *light;
    (0..columns * rows).map(move |k| {
        let steps = [(k % columns, columns), (k / columns, rows)]
            .map(|(index, count)| 2.0 * index as f32 + 1.0 - count as f32);
        let position = Vec3::from(light.position) + u * steps[0] + v * steps[1];
        let first_face = light.first_face + RECT_FACES * k;
        let light = Light { position: position.into(), first_face, face_count: RECT_FACES, ..light };
        Cell { light, sides: [u, v] }
    })
}

fn is_behind(light: &Light, position: Vec3) -> bool {
    (position - Vec3::from(light.position)).dot(light.direction.into()) <= 0.0
}

/// Irradiance of a rectangle in W·m⁻² without occluders.
pub(super) fn rect_unshadowed(plan: &ShadowPlan, light: &Light, position: Vec3, normal: Vec3) -> Vec3 {
    if is_behind(light, position) {
        return Vec3::ZERO;
    }
    let factor = |Cell { light, sides: [u, v] }: Cell| {
        rect_factor(Vec3::from(light.position) - position, u, v, normal)
    };
    Vec3::from(light.strength) * cells(plan, light).map(factor).sum::<f32>()
}

/// Irradiance of a rectangle in W·m⁻², and the share of it that arrives. Shadows are those of `before`. Cells whose middle
/// lies under the surface's own horizon have the share of the others: no shadow map tells of them. Where that is so of all that
/// send light, nobody knows and it is dark: light through a wall would be worse. More points leave less of it.
pub(super) fn rect_irradiance(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    light: &Light,
    [position, before]: [Vec3; 2],
    normal: Vec3,
    facet: Vec3,
) -> Vec4 {
    if is_behind(light, position) {
        return Vec4::ZERO;
    }
    let [mut total, mut judged, mut arriving] = [0.0_f32; 3];
    for Cell { light: cell, sides: [u, v] } in cells(plan, light) {
        let middle = Vec3::from(cell.position);
        let factor = rect_factor(middle - position, u, v, normal);
        if factor <= 0.0 {
            continue;
        }
        total += factor;
        if facet.dot(middle - before) > 0.0 {
            judged += factor;
            let face = face_of(plan, &cell, before);
            arriving += factor * share_by((plan, maps), face, &cell, before, facet);
        }
    }
    let share = arriving / judged.max(1e-30);
    (Vec3::from(light.strength) * (total * share)).extend(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ cosθ cosθ'/d² dA over the part above the horizon, by squares of a grid.
    fn by_squares(middle: Vec3, u: Vec3, v: Vec3, normal: Vec3) -> f64 {
        const SIDE: u32 = 300;
        let [middle, u, v, normal] = [middle, u, v, normal].map(Vec3::as_dvec3);
        let across = u.cross(v) * (4.0 / f64::from(SIDE * SIDE));
        let along = |step: u32| f64::from(2 * step + 1) / f64::from(SIDE) - 1.0;
        let at = |index: u32| {
            let point = middle + u * along(index % SIDE) + v * along(index / SIDE);
            let squared = point.length_squared();
            point.dot(normal).max(0.0) * across.dot(point).abs() / (squared * squared)
        };
        (0..SIDE * SIDE).map(at).sum()
    }

    #[test]
    fn closed_form_is_the_integral_over_the_rectangle_above_the_horizon() {
        let (mut cut, mut seen) = (0, 0);
        for index in 0..400_u32 {
            let turn = index as f32;
            let middle = Vec3::new((1.3 * turn).sin(), (0.7 * turn).cos(), 0.4 + 0.05 * turn) * 0.9;
            let normal =
                Vec3::new((2.1 * turn).cos(), (3.3 * turn).sin(), 0.3 + (0.9 * turn).sin()).normalize();
            let u = Vec3::new((0.3 * turn).cos(), (0.3 * turn).sin(), 0.0) * (0.1 + 0.002 * turn);
            let v = u.cross(Vec3::new(0.4, (turn).sin(), 2.0)).normalize() * 0.35;
            // Squares as wide as they are far away tell nothing.
            if u.cross(v).normalize().dot(middle).abs() < 0.2 {
                continue;
            }
            let heights = [-u - v, u - v, u + v, v - u].map(|corner| (middle + corner).dot(normal));
            let is_cut = heights.iter().any(|h| *h < 0.0) && heights.iter().any(|h| *h > 0.0);
            // Either winding: it is the caller who knows the front.
            let found = rect_factor(middle, u, v, normal).max(rect_factor(middle, -u, v, normal));
            let wanted = by_squares(middle, u, v, normal);
            assert!(
                (f64::from(found) - wanted).abs() < 2e-3 * wanted + 2e-5,
                "{index}: {found}, wanted {wanted}"
            );
            cut += u32::from(is_cut);
            seen += u32::from(wanted > 0.01);
        }
        assert!(cut > 20 && seen > 50, "{cut} cut, {seen} seen");
    }

    #[test]
    fn wide_rectangle_fills_the_hemisphere_and_a_far_one_is_a_point() {
        let wide = rect_factor(Vec3::Z, Vec3::X * 2000.0, Vec3::Y * 2000.0, Vec3::Z);
        assert!((wide / PI - 1.0).abs() < 1e-3, "{wide}");
        // Upright on the horizon: half of it.
        let half = rect_factor(Vec3::X * 0.01, Vec3::Y * 2000.0, Vec3::Z * 2000.0, Vec3::Z);
        assert!((half / (0.5 * PI) - 1.0).abs() < 1e-3, "{half}");
        let (u, v) = (Vec3::new(0.5, 0.2, 0.0), Vec3::new(-0.04, 0.1, 0.0));
        let diagonal = 2.0 * (u.length_squared() + v.length_squared()).sqrt();
        let at = |far: f32| {
            let middle = Vec3::new(0.3, -0.2, 0.9).normalize() * far * diagonal;
            rect_factor(middle, u, v, Vec3::Z) * far * far
        };
        // Little jumps where the closed form gives way to the point.
        assert!(
            (at(0.999 * FAR) / at(1.001 * FAR) - 1.0).abs() < 2e-4,
            "{} {}",
            at(0.999 * FAR),
            at(1.001 * FAR)
        );
        assert_eq!(rect_factor(Vec3::NEG_Z, u, v, Vec3::Z), 0.0);
    }
}
