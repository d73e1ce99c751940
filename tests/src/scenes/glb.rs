//! A small writer of binary glTF.
//!
//! The bytes are a pure function of the calls: no clock, no hash map, no float formatting that depends on the
//! platform. All functions panic on misuse (a mesh without triangles, more than 4 GiB), for the callers are our
//! own generators.

use glam::Vec3;

use super::document::*;
use super::mesh::Mesh;

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const REPEAT: u32 = 10497;

/// A material, as [`Glb::material`] takes it.
#[derive(Clone, Debug)]
pub struct Surface {
    name: String,
    albedo: [f32; 3],
    emission: [f32; 3],
    double_sided: bool,
    texture: Option<TextureId>,
    normal_map: Option<TextureId>,
    metallic: f32,
    roughness: f32,
    /// Share that is there, of a surface that blends.
    alpha: Option<f32>,
    transmission: f32,
}

impl Surface {
    /// A diffuse single-sided surface; `albedo` is linear Rec.709.
    pub fn diffuse(name: &str, albedo: [f32; 3]) -> Self {
        Self {
            name: name.into(),
            albedo,
            emission: [0.0; 3],
            double_sided: false,
            texture: None,
            normal_map: None,
            metallic: 0.0,
            roughness: 1.0,
            alpha: None,
            transmission: 0.0,
        }
    }

    /// Adds emitted radiance in W·m⁻²·sr⁻¹.
    pub fn emitting(self, emission: [f32; 3]) -> Self {
        Self { emission, ..self }
    }

    /// Makes both sides lit.
    pub fn double_sided(self) -> Self {
        Self { double_sided: true, ..self }
    }

    /// Makes it glass of alphaMode BLEND, which stops `alpha` of the light; both sides are lit.
    pub fn blended(self, alpha: f32) -> Self {
        Self { alpha: Some(alpha), double_sided: true, ..self }
    }

    /// Lets a share of the light through, tinted by the albedo; both sides are lit.
    pub fn transmitting(self, share: f32) -> Self {
        Self { transmission: share, double_sided: true, ..self }
    }

    /// Multiplies the albedo by an image, read at the mesh's texture coordinates.
    pub fn textured(self, texture: TextureId) -> Self {
        Self { texture: Some(texture), ..self }
    }

    /// Bends its normals by an image, read at the mesh's texture coordinates.
    pub fn bent(self, normal_map: TextureId) -> Self {
        Self { normal_map: Some(normal_map), ..self }
    }

    /// Reflects as microfacets of that share of metal and that roughness.
    pub fn reflecting(self, metallic: f32, roughness: f32) -> Self {
        Self { metallic, roughness, ..self }
    }
}

/// A KHR_lights_punctual light without its place.
#[derive(Clone, Copy, Debug)]
pub enum Lamp {
    /// Same in all directions.
    Point,
    /// A cone around the aim; half angles in radians.
    Spot {
        /// Full intensity inside.
        inner_rad: f32,
        /// None outside.
        outer_rad: f32,
    },
    /// Parallel light.
    Sun,
}

/// Names a material of a [`Glb`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaterialId(u32);

/// Names a mesh of a [`Glb`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshId(u32);

/// Names a texture of a [`Glb`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextureId(u32);

/// A file under construction.
pub struct Glb {
    document: Document,
    lights: Vec<LightEntry>,
    bin: Vec<u8>,
}

impl Glb {
    /// An empty scene called `name`.
    pub fn new(name: &str) -> Self {
        let scenes = vec![SceneRoots { name: name.into(), nodes: Vec::new() }];
        Self { document: Document { scenes, ..Document::default() }, lights: Vec::new(), bin: Vec::new() }
    }

    /// Embeds a PNG that repeats in both directions.
    pub fn texture(&mut self, name: &str, png: &[u8]) -> TextureId {
        let buffer_view = self.view(png, None);
        self.document.images.push(ImageEntry { name: name.into(), mime_type: "image/png", buffer_view });
        if self.document.samplers.is_empty() {
            self.document.samplers.push(Sampler {
                mag_filter: LINEAR,
                min_filter: LINEAR_MIPMAP_LINEAR,
                wrap_s: REPEAT,
                wrap_t: REPEAT,
            });
        }
        let source = index_of_last(&self.document.images);
        self.document.textures.push(TextureEntry { sampler: 0, source });
        TextureId(index_of_last(&self.document.textures))
    }

    /// Adds a material. Emission above 1 is split into a factor and KHR_materials_emissive_strength.
    pub fn material(&mut self, surface: Surface) -> MaterialId {
        let peak = surface.emission.iter().copied().fold(0.0, f32::max);
        let strength = peak.max(1.0);
        let [r, g, b] = surface.albedo;
        if strength > 1.0 {
            self.uses("KHR_materials_emissive_strength");
        }
        if surface.transmission > 0.0 {
            self.uses("KHR_materials_transmission");
        }
        let extensions = MaterialExtensions {
            emissive_strength: (strength > 1.0).then_some(EmissiveStrength { emissive_strength: strength }),
            transmission: (surface.transmission > 0.0)
                .then_some(Transmission { transmission_factor: surface.transmission }),
        };
        let is_extended = extensions.emissive_strength.is_some() || extensions.transmission.is_some();
        self.document.materials.push(MaterialEntry {
            name: surface.name,
            pbr_metallic_roughness: PbrEntry {
                base_color_factor: [r, g, b, surface.alpha.unwrap_or(1.0)],
                base_color_texture: surface.texture.map(|texture| TextureRef { index: texture.0 }),
                metallic_factor: surface.metallic,
                roughness_factor: surface.roughness,
            },
            normal_texture: surface.normal_map.map(|texture| TextureRef { index: texture.0 }),
            emissive_factor: (peak > 0.0).then(|| surface.emission.map(|e| e / strength)),
            alpha_mode: surface.alpha.map(|_| "BLEND"),
            double_sided: surface.double_sided,
            extensions: is_extended.then_some(extensions),
        });
        MaterialId(index_of_last(&self.document.materials))
    }

    /// Adds a mesh of one primitive per (shape, material). Texture coordinates are stored where they are read.
    pub fn mesh(&mut self, name: &str, parts: &[(&Mesh, MaterialId)]) -> MeshId {
        let primitives = parts.iter().map(|&(mesh, material)| self.primitive(name, mesh, material)).collect();
        self.document.meshes.push(MeshEntry { name: name.into(), primitives });
        MeshId(index_of_last(&self.document.meshes))
    }

    fn primitive(&mut self, name: &str, mesh: &Mesh, material: MaterialId) -> Primitive {
        assert!(!mesh.triangles.is_empty(), "mesh {name} has no triangles");
        assert_eq!(mesh.positions_m.len(), mesh.normals.len(), "mesh {name}: a normal per vertex");
        assert_eq!(mesh.positions_m.len(), mesh.uvs.len(), "mesh {name}: a texture coordinate per vertex");
        let look = &self.document.materials[material.0 as usize];
        let textured =
            look.pbr_metallic_roughness.base_color_texture.is_some() || look.normal_texture.is_some();
        let normals: Vec<[f32; 3]> = mesh.normals.iter().map(Vec3::to_array).collect();
        let positions_m: Vec<[f32; 3]> = mesh.positions_m.iter().map(Vec3::to_array).collect();
        let low = mesh.positions_m.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = mesh.positions_m.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let position = self.floats(positions_m.as_flattened(), 3);
        let accessor = &mut self.document.accessors[position as usize];
        accessor.min = Some(low.to_array());
        accessor.max = Some(high.to_array());
        let attributes = Attributes {
            position,
            normal: self.floats(normals.as_flattened(), 3),
            texcoord_0: textured.then(|| {
                let uvs: Vec<[f32; 2]> = mesh.uvs.iter().map(glam::Vec2::to_array).collect();
                self.floats(uvs.as_flattened(), 2)
            }),
        };
        Primitive { attributes, indices: self.indices(mesh), material: material.0 }
    }

    fn floats(&mut self, values: &[f32], width: usize) -> u32 {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let kind = if width == 3 { "VEC3" } else { "VEC2" };
        self.accessor(&bytes, ARRAY_BUFFER, FLOAT, values.len() / width, kind)
    }

    fn indices(&mut self, mesh: &Mesh) -> u32 {
        let flat = mesh.triangles.as_flattened();
        // 65535 itself restarts a primitive in some APIs and is not allowed.
        let (bytes, component): (Vec<u8>, u32) = if mesh.positions_m.len() <= 65_535 {
            (flat.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect(), UNSIGNED_SHORT)
        } else {
            (flat.iter().flat_map(|index| index.to_le_bytes()).collect(), UNSIGNED_INT)
        };
        self.accessor(&bytes, ELEMENT_ARRAY_BUFFER, component, flat.len(), "SCALAR")
    }

    fn accessor(
        &mut self,
        bytes: &[u8],
        target: u32,
        component: u32,
        count: usize,
        kind: &'static str,
    ) -> u32 {
        let buffer_view = self.view(bytes, Some(target));
        let count = small(count);
        let accessor = Accessor { buffer_view, component_type: component, count, kind, min: None, max: None };
        self.document.accessors.push(accessor);
        index_of_last(&self.document.accessors)
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> u32 {
        pad(&mut self.bin, 0);
        let byte_offset = small(self.bin.len());
        self.bin.extend_from_slice(bytes);
        let view = BufferView { buffer: 0, byte_offset, byte_length: small(bytes.len()), target };
        self.document.buffer_views.push(view);
        index_of_last(&self.document.buffer_views)
    }

    /// Adds a mesh and the one node that shows it, both called `name`.
    pub fn object(&mut self, name: &str, mesh: &Mesh, material: MaterialId) {
        let id = self.mesh(name, &[(mesh, material)]);
        self.place(name, id, Vec3::ZERO, 0.0);
    }

    /// Shows a mesh at a place, turned by `yaw_rad` about the y axis (from +z towards +x).
    pub fn place(&mut self, name: &str, mesh: MeshId, translation_m: Vec3, yaw_rad: f32) {
        let half = 0.5 * yaw_rad;
        let rotation = (yaw_rad != 0.0).then(|| [0.0, libm::sinf(half), 0.0, libm::cosf(half)]);
        let translation = (translation_m != Vec3::ZERO).then(|| translation_m.to_array());
        self.root(Node { name: name.into(), translation, rotation, mesh: Some(mesh.0), ..Node::default() });
    }

    /// Adds a mesh and the one node that shows it scaled along the axes; negative factors mirror it.
    pub fn object_scaled(&mut self, name: &str, mesh: &Mesh, material: MaterialId, scale: Vec3) {
        let mesh = self.mesh(name, &[(mesh, material)]);
        let scale = Some(scale.to_array());
        self.root(Node { name: name.into(), scale, mesh: Some(mesh.0), ..Node::default() });
    }

    /// Adds a light. Point and spot: `intensity` in W·sr⁻¹; sun: irradiance in W·m⁻². A point light ignores its aim.
    pub fn light(&mut self, name: &str, lamp: Lamp, strength: [f32; 3], eye_m: Vec3, target_m: Vec3) {
        let peak = strength.iter().copied().fold(0.0, f32::max);
        assert!(peak > 0.0, "light {name} is dark");
        let (kind, spot) = match lamp {
            Lamp::Point => ("point", None),
            Lamp::Sun => ("directional", None),
            Lamp::Spot { inner_rad, outer_rad } => {
                ("spot", Some(SpotEntry { inner_cone_angle: inner_rad, outer_cone_angle: outer_rad }))
            }
        };
        let color = strength.map(|channel| channel / peak);
        self.lights.push(LightEntry { name: name.into(), kind, color, intensity: peak, spot });
        self.uses("KHR_lights_punctual");
        let rotation = (!matches!(lamp, Lamp::Point)).then(|| rotation_towards(target_m - eye_m));
        let light = index_of_last(&self.lights);
        let extensions = Some(NodeExtensions { lights_punctual: LightRef { light } });
        let translation = Some(eye_m.to_array());
        self.root(Node { name: name.into(), translation, rotation, extensions, ..Node::default() });
    }

    /// Adds a camera; the first one is the scene's view.
    pub fn camera(&mut self, name: &str, eye_m: Vec3, target_m: Vec3, fov_y_rad: f32) {
        let perspective = Perspective { yfov: fov_y_rad, znear: 0.05 };
        self.document.cameras.push(CameraEntry { name: name.into(), kind: "perspective", perspective });
        self.root(Node {
            name: name.into(),
            translation: Some(eye_m.to_array()),
            rotation: Some(rotation_towards(target_m - eye_m)),
            camera: Some(index_of_last(&self.document.cameras)),
            ..Node::default()
        });
    }

    fn root(&mut self, node: Node) {
        self.document.nodes.push(node);
        self.document.scenes[0].nodes.push(index_of_last(&self.document.nodes));
    }

    fn uses(&mut self, extension: &'static str) {
        if !self.document.extensions_used.contains(&extension) {
            self.document.extensions_used.push(extension);
        }
    }

    /// The finished file.
    pub fn finish(mut self) -> Vec<u8> {
        if !self.lights.is_empty() {
            self.document.extensions =
                Some(DocumentExtensions { lights_punctual: LightList { lights: self.lights } });
        }
        pad(&mut self.bin, 0);
        self.document.buffers.push(BufferEntry { byte_length: small(self.bin.len()) });
        let mut json =
            serde_json::to_vec(&self.document).expect("plain structs with finite floats serialise");
        pad(&mut json, b' ');

        let total = 12 + 8 + json.len() + 8 + self.bin.len();
        let mut file = Vec::with_capacity(total);
        file.extend_from_slice(b"glTF");
        file.extend_from_slice(&2u32.to_le_bytes());
        file.extend_from_slice(&small(total).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &self.bin)] {
            file.extend_from_slice(&small(chunk.len()).to_le_bytes());
            file.extend_from_slice(kind);
            file.extend_from_slice(chunk);
        }
        file
    }
}

/// The quaternion (xyzw) that turns −z to `direction`, with +y kept up.
fn rotation_towards(direction: Vec3) -> [f32; 4] {
    let back = -direction.normalize();
    let up = if back.y.abs() > 0.999 { Vec3::Z } else { Vec3::Y };
    let x = up.cross(back).normalize();
    let y = back.cross(x);
    let z = back;
    // Largest component first, so that the division is well conditioned.
    let squares =
        [1.0 + x.x - y.y - z.z, 1.0 - x.x + y.y - z.z, 1.0 - x.x - y.y + z.z, 1.0 + x.x + y.y + z.z];
    let largest = (0..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let twice = squares[largest].sqrt();
    let scale = 0.5 / twice;
    let (yz, zx, xy) = (y.z - z.y, z.x - x.z, x.y - y.x);
    let (syz, szx, sxy) = (y.z + z.y, z.x + x.z, x.y + y.x);
    let half = 0.5 * twice;
    match largest {
        0 => [half, sxy * scale, szx * scale, yz * scale],
        1 => [sxy * scale, half, syz * scale, zx * scale],
        2 => [szx * scale, syz * scale, half, xy * scale],
        _ => [yz * scale, zx * scale, xy * scale, half],
    }
}

fn pad(bytes: &mut Vec<u8>, filler: u8) {
    while !bytes.len().is_multiple_of(4) {
        bytes.push(filler);
    }
}

fn small(count: usize) -> u32 {
    u32::try_from(count).expect("a test scene stays below 4 GiB")
}

fn index_of_last<T>(list: &[T]) -> u32 {
    small(list.len() - 1)
}
