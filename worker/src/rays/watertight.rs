//! Watertight ray–triangle intersection: \[Woop2013\] "Watertight Ray/Triangle Intersection", JCGT 2(1), §3.

use glam::Vec3;

/// A ray prepared for the watertight test: the largest direction axis becomes z, the others are sheared to zero.
#[derive(Clone, Copy, Debug)]
pub(super) struct WatertightRay {
    origin: Vec3,
    axis: [usize; 3],
    shear: Vec3,
}

/// Distance in units of the ray's direction and barycentric weights of corners 1 and 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TriangleHit {
    pub t: f32,
    pub barycentric: [f32; 2],
}

impl WatertightRay {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = Vec3::new(direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]);
        Self { origin, axis: [x, y, z], shear }
    }

    /// Axes of the test: the largest of the direction last.
    #[inline(always)]
    pub fn axis(&self) -> [usize; 3] {
        self.axis
    }

    /// Shear along the first two axes, and 1 over the direction along the last.
    #[inline(always)]
    pub fn shear(&self) -> Vec3 {
        self.shear
    }

    /// Hit with `0 ≤ t`, from either side; `None` when missed or the triangle is edge on.
    pub fn intersect(&self, corners: &[Vec3; 3]) -> Option<TriangleHit> {
        let [kx, ky, kz] = self.axis;
        let [a, b, c] = corners.map(|corner| corner - self.origin);
        let (ax, ay) = (a[kx] - self.shear.x * a[kz], a[ky] - self.shear.y * a[kz]);
        let (bx, by) = (b[kx] - self.shear.x * b[kz], b[ky] - self.shear.y * b[kz]);
        let (cx, cy) = (c[kx] - self.shear.x * c[kz], c[ky] - self.shear.y * c[kz]);
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        if u == 0.0 || v == 0.0 || w == 0.0 {
            // An edge passes through the ray as far as f32 can tell: decide it in f64, the same for both neighbours.
            u = edge_f64(cx, by, cy, bx);
            v = edge_f64(ax, cy, ay, cx);
            w = edge_f64(bx, ay, by, ax);
        }
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let scale = 1.0 / determinant;
        let t = (u * a[kz] + v * b[kz] + w * c[kz]) * self.shear.z * scale;
        // `t >= 0` is false for NaN too.
        (t >= 0.0).then_some(TriangleHit { t, barycentric: [v * scale, w * scale] })
    }
}

fn edge_f64(a: f32, b: f32, c: f32, d: f32) -> f32 {
    (f64::from(a) * f64::from(b) - f64::from(c) * f64::from(d)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn barycentrics_and_distance_are_those_of_the_point_hit() {
        let corners = [Vec3::new(0.0, 0.0, 2.0), Vec3::new(1.0, 0.0, 2.0), Vec3::new(0.0, 1.0, 2.0)];
        let hit = WatertightRay::new(Vec3::new(0.25, 0.5, 0.0), Vec3::Z).intersect(&corners).unwrap();
        assert!((hit.t - 2.0).abs() < 1e-6);
        assert!((hit.barycentric[0] - 0.25).abs() < 1e-6 && (hit.barycentric[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn rays_at_a_shared_edge_hit_at_least_one_neighbour() {
        let (a, b) = (Vec3::new(-1.3, 0.7, 5.1), Vec3::new(2.9, -1.1, 4.3));
        let (c, d) = (Vec3::new(2.0, 3.0, 5.0), Vec3::new(-2.0, -3.0, 4.7));
        for step in 0..1000 {
            let target = a.lerp(b, step as f32 / 1000.0);
            let ray =
                WatertightRay::new(Vec3::new(0.1, 0.2, 0.3), (target - Vec3::new(0.1, 0.2, 0.3)).normalize());
            assert!(
                ray.intersect(&[a, b, c]).is_some() || ray.intersect(&[b, a, d]).is_some(),
                "step {step}"
            );
        }
    }

    #[test]
    fn triangle_behind_the_origin_or_edge_on_is_missed() {
        let corners = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];
        assert!(WatertightRay::new(Vec3::Z, Vec3::Z).intersect(&corners).is_none());
        assert!(WatertightRay::new(Vec3::new(-5.0, 0.0, 0.0), Vec3::X).intersect(&corners).is_none());
    }
}
