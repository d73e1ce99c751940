//! Triangles in the making.

use glam::{Vec2, Vec3};

/// An indexed triangle mesh: unit normals, counter-clockwise from the front, texture coordinates in metres
/// (or as its shape says) until [`Mesh::with_uv_scale`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions in metres.
    pub positions_m: Vec<Vec3>,
    /// Unit normals, one per vertex.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one per vertex.
    pub uvs: Vec<Vec2>,
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Adds a vertex and gives its index.
    pub fn vertex(&mut self, position_m: Vec3, normal: Vec3, uv: Vec2) -> u32 {
        self.positions_m.push(position_m);
        self.normals.push(normal);
        self.uvs.push(uv);
        u32::try_from(self.positions_m.len() - 1).expect("a test scene has few vertices")
    }

    /// Adds a flat four-sided face, corners counter-clockwise from the front; `uvs` belong to the corners.
    pub fn face(&mut self, corners: [Vec3; 4], uvs: [Vec2; 4]) {
        let normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]).normalize();
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| self.vertex(corners[i], normal, uvs[i]));
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// Adds a rectangle whose normal is `u × v`, with texture coordinates in metres along its edges.
    pub fn rectangle(&mut self, corner: Vec3, u: Vec3, v: Vec3) {
        let (width, height) = (u.length(), v.length());
        let uvs = [[0.0, height], [width, height], [width, 0.0], [0.0, 0.0]].map(Vec2::from);
        self.face([corner, corner + u, corner + u + v, corner + v], uvs);
    }

    /// Adds a grid of `columns × rows` cells over vertices that `at(i, j)` gives as (position, normal, uv), where
    /// the front is seen with i to the right and j upwards. Cells collapsed to a line or point are left out.
    pub fn grid(&mut self, columns: u32, rows: u32, at: impl Fn(u32, u32) -> (Vec3, Vec3, Vec2)) {
        let first = self.positions_m.len() as u32;
        for j in 0..=rows {
            for i in 0..=columns {
                let (position, normal, uv) = at(i, j);
                self.vertex(position, normal, uv);
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = first + j * (columns + 1) + i;
                let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
                self.solid_triangle([a, b, c]);
                self.solid_triangle([a, c, d]);
            }
        }
    }

    /// Adds a triangle unless it has no area.
    pub fn solid_triangle(&mut self, corners: [u32; 3]) {
        let [a, b, c] = corners.map(|corner| self.positions_m[corner as usize]);
        if (b - a).cross(c - a).length() > 1e-9 {
            self.triangles.push(corners);
        }
    }

    /// Replaces every normal by the mean of the faces around its vertex, weighted by their area.
    pub fn smooth_normals(&mut self) {
        self.normals.fill(Vec3::ZERO);
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|corner| self.positions_m[corner as usize]);
            let across = (b - a).cross(c - a);
            for corner in triangle {
                self.normals[*corner as usize] += across;
            }
        }
        for normal in &mut self.normals {
            *normal = normal.normalize();
        }
    }

    /// Adds another mesh.
    pub fn append(&mut self, other: &Mesh) {
        let first = self.positions_m.len() as u32;
        self.positions_m.extend_from_slice(&other.positions_m);
        self.normals.extend_from_slice(&other.normals);
        self.uvs.extend_from_slice(&other.uvs);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
    }

    /// Moved by `offset_m`.
    pub fn translated(mut self, offset_m: Vec3) -> Self {
        for position in &mut self.positions_m {
            *position += offset_m;
        }
        self
    }

    /// Turned about the y axis, from +z towards +x.
    pub fn turned(mut self, yaw_rad: f32) -> Self {
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        let turn = |v: Vec3| Vec3::new(cos * v.x + sin * v.z, v.y, cos * v.z - sin * v.x);
        for vector in self.positions_m.iter_mut().chain(&mut self.normals) {
            *vector = turn(*vector);
        }
        self
    }

    /// Turned inside out.
    pub fn flipped(mut self) -> Self {
        for normal in &mut self.normals {
            *normal = -*normal;
        }
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
        self
    }

    /// Texture coordinates multiplied, to go from metres to repeats of an image.
    pub fn with_uv_scale(mut self, scale: Vec2) -> Self {
        for uv in &mut self.uvs {
            *uv *= scale;
        }
        self
    }
}
