//! Flat-faced shapes: boxes, rooms, frames, walls with holes.

use glam::Vec3;

use super::mesh::Mesh;

/// A side of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// −x.
    Left,
    /// +x.
    Right,
    /// −y.
    Bottom,
    /// +y.
    Top,
    /// −z.
    Back,
    /// +z.
    Front,
}

impl Side {
    /// All six.
    pub const ALL: [Side; 6] = [Side::Left, Side::Right, Side::Bottom, Side::Top, Side::Back, Side::Front];
}

/// One face of the box from `min` to `max`, seen from outside.
pub fn box_side(min: Vec3, max: Vec3, side: Side) -> Mesh {
    let size = max - min;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let mut mesh = Mesh::default();
    match side {
        Side::Left => mesh.rectangle(min, z, y),
        Side::Right => mesh.rectangle(min + x + z, -z, y),
        Side::Bottom => mesh.rectangle(min, x, z),
        Side::Top => mesh.rectangle(min + y + z, x, -z),
        Side::Back => mesh.rectangle(min + x, -x, y),
        Side::Front => mesh.rectangle(min + z, x, y),
    }
    mesh
}

/// A box seen from outside, without the sides in `omitted`.
pub fn cuboid(min: Vec3, max: Vec3, omitted: &[Side]) -> Mesh {
    let mut mesh = Mesh::default();
    for side in Side::ALL.into_iter().filter(|side| !omitted.contains(side)) {
        mesh.append(&box_side(min, max, side));
    }
    mesh
}

/// A box that stands on a floor at y = 0 (no bottom face), turned about its centre.
pub fn standing_box(centre_m: Vec3, size_m: Vec3, yaw_rad: f32) -> Mesh {
    let half = Vec3::new(0.5 * size_m.x, 0.0, 0.5 * size_m.z);
    cuboid(-half, half + Vec3::Y * size_m.y, &[Side::Bottom]).turned(yaw_rad).translated(centre_m)
}

/// A room: the box from `min` to `max` seen from inside, without the sides in `omitted`.
pub fn room(min: Vec3, max: Vec3, omitted: &[Side]) -> Mesh {
    cuboid(min, max, omitted).flipped()
}

/// One face of a room, seen from inside.
pub fn room_side(min: Vec3, max: Vec3, side: Side) -> Mesh {
    box_side(min, max, side).flipped()
}

/// A horizontal rectangle at the height of `min` with a rectangular hole, seen from above. The parts meet at full
/// edges, so no light can pass between them. `min.y` is the height; the hole's y is not read.
pub fn floor_with_hole(min: Vec3, max: Vec3, hole_min: Vec3, hole_max: Vec3) -> Mesh {
    let xs = [min.x, hole_min.x, hole_max.x, max.x];
    let zs = [min.z, hole_min.z, hole_max.z, max.z];
    let mut mesh = Mesh::default();
    for j in 0..3 {
        for i in (0..3).filter(|&i| (i, j) != (1, 1)) {
            let corner = Vec3::new(xs[i], min.y, zs[j + 1]);
            mesh.rectangle(corner, Vec3::X * (xs[i + 1] - xs[i]), Vec3::Z * (zs[j] - zs[j + 1]));
        }
    }
    mesh
}

/// A slab from `min` to `max` with a rectangular hole through it from top to bottom, seen from outside.
pub fn frame(min: Vec3, max: Vec3, hole_min: Vec3, hole_max: Vec3) -> Mesh {
    let raise = Vec3::Y * (max.y - min.y);
    let bottom = floor_with_hole(min, max, hole_min, hole_max);
    let mut mesh = bottom.clone().translated(raise);
    mesh.append(&bottom.flipped());
    let omitted = [Side::Top, Side::Bottom];
    mesh.append(&cuboid(min, max, &omitted));
    let hole_min = Vec3::new(hole_min.x, min.y, hole_min.z);
    let hole_max = Vec3::new(hole_max.x, max.y, hole_max.z);
    mesh.append(&room(hole_min, hole_max, &omitted));
    mesh
}

/// A box with a box-shaped hollow: both skins, nothing between them, so that no path leads inside.
pub fn hollow_box(min: Vec3, max: Vec3, thickness_m: f32) -> Mesh {
    let inset = Vec3::splat(thickness_m);
    let mut mesh = cuboid(min, max, &[]);
    mesh.append(&room(min + inset, max - inset, &[]));
    mesh
}
