//! Normals by a normal map, in a frame that the surface's own texture coordinates give; twin of `normals.wgsl`.

use glam::{Vec2, Vec3};

/// Least square of a tangent's part along the surface, of its own.
const TANGENT_MIN: f32 = 1e-6;

/// The normal that a texel of a map says (METHOD.md §2.15): texel x along the texture's u, y towards its upper edge, z is `height`.
///
/// `steps` are two steps on the surface, each with its change of the map's coordinates. The interpolated normal itself where these give
/// no frame, as for a triangle without texture coordinates.
pub fn mapped_normal(normal: Vec3, steps: [(Vec3, Vec2); 2], texel: Vec2, height: f32) -> Vec3 {
    let [(first, uv_first), (second, uv_second)] = steps;
    let turn = if uv_first.x * uv_second.y >= uv_second.x * uv_first.y { 1.0 } else { -1.0 };
    let along_u = turn * (first * uv_second.y - second * uv_first.y);
    let along_v = turn * (second * uv_first.x - first * uv_second.x);
    let flat_u = along_u - normal * normal.dot(along_u);
    let is_frame = flat_u.length_squared() > TANGENT_MIN * along_u.length_squared();
    if !is_frame {
        return normal;
    }
    let tangent = flat_u / flat_u.length();
    let across = normal.cross(tangent);
    // The texture's upper edge is where v is least.
    let bitangent = if across.dot(along_v) < 0.0 { across } else { -across };
    let bent = tangent * texel.x + bitangent * texel.y + normal * height;
    if bent.length_squared() > 1e-12 { bent / bent.length() } else { normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall that faces +z: u goes right, v down, as textures do.
    const UPRIGHT: [(Vec3, Vec2); 2] = [(Vec3::X, Vec2::X), (Vec3::Y, Vec2::NEG_Y)];

    #[test]
    fn x_is_along_u_and_y_is_up_in_the_texture() {
        let mapped = |texel| mapped_normal(Vec3::Z, UPRIGHT, texel, 0.5);
        let expected = |x: f32, y: f32| Vec3::new(x, y, 0.5).normalize();
        assert!(mapped(Vec2::new(0.3, 0.0)).abs_diff_eq(expected(0.3, 0.0), 1e-6));
        assert!(mapped(Vec2::new(0.0, 0.3)).abs_diff_eq(expected(0.0, 0.3), 1e-6));
        assert_eq!(mapped(Vec2::ZERO), Vec3::Z);
    }

    /// Steps of any kind give the same frame; mirrored coordinates turn x alone.
    #[test]
    fn frame_hangs_on_the_texture_alone() {
        let texel = Vec2::new(0.4, -0.2);
        let wanted = mapped_normal(Vec3::Z, UPRIGHT, texel, 0.8);
        let step = |x: f32, y: f32| (Vec3::new(x, y, 0.0), Vec2::new(x, -y));
        for steps in [[step(0.2, 0.1), step(-0.3, 0.4)], [step(-0.3, 0.4), step(0.2, 0.1)]] {
            let found = mapped_normal(Vec3::Z, steps, texel, 0.8);
            assert!(found.abs_diff_eq(wanted, 1e-6), "{found}");
        }
        let mirrored = UPRIGHT.map(|(step, uv)| (step, uv * Vec2::new(-1.0, 1.0)));
        let found = mapped_normal(Vec3::Z, mirrored, texel, 0.8);
        assert!(found.abs_diff_eq(wanted * Vec3::new(-1.0, 1.0, 1.0), 1e-6), "{found}");
    }

    #[test]
    fn surface_without_a_frame_keeps_its_normal() {
        let texel = Vec2::new(0.5, 0.5);
        for steps in [[(Vec3::X, Vec2::ZERO); 2], [(Vec3::Z, Vec2::X), (Vec3::Z, Vec2::Y)]] {
            assert_eq!(mapped_normal(Vec3::Z, steps, texel, 0.5), Vec3::Z);
        }
        assert_eq!(mapped_normal(Vec3::Z, UPRIGHT, Vec2::ZERO, 0.0), Vec3::Z);
    }
}
