//! Meshes of an export: each side that has light of its own is a mesh of its own.

use glam::{Mat3, Quat, Vec3};
use lightkiln_proto::scene::SceneCamera;
use serde_json::{Map, Value, json};

use super::glb::Glb;
use super::materials::{Look, Materials, uv_maps, uv_set};
use super::pages::{GUTTER, Pages, Place};
use crate::error::Result;
use crate::passes::shade::surface::moved_uv;
use crate::scene::{LoadedDraw, LoadedScene, Vertex};

/// A side of a mesh, or both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Side {
    is_back: bool,
    block: u32,
    look: Look,
    place: Option<Place>,
}

/// Meshes that are exported with less light than they show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unlit {
    /// Without any.
    pub meshes: usize,
    /// Seen from both sides, with light on one.
    pub backs: usize,
}

/// Places of the blocks in pages, and texels of these along each of the lightmap's.
#[derive(Clone, Copy, Debug)]
pub struct Atlas<'a> {
    /// Pages and places.
    pub pages: &'a Pages,
    /// Texels along each of the lightmap's.
    pub scale: u32,
}

/// Writes the meshes of a scene, a node each. Errs where a material cannot be written.
pub fn write(
    glb: &mut Glb,
    scene: &LoadedScene,
    materials: &mut Materials<'_>,
    atlas: Atlas<'_>,
) -> Result<Unlit> {
    let mut unlit = Unlit::default();
    for draw in scene.draws.draws.iter().filter(|draw| !draw.triangles.is_empty()) {
        let sides = sides(scene, draw, atlas.pages);
        let lit = sides.iter().filter(|side| side.place.is_some()).count();
        unlit.meshes += usize::from(lit == 0);
        unlit.backs += usize::from(lit == 1 && sides.len() == 2);
        let shared = Shared::write(glb, scene, draw);
        for side in sides {
            let material = materials.of(glb, side.look)?;
            let attributes = shared.attributes(glb, (draw, &side), atlas);
            let indices = glb.triangles(&turned(&draw.triangles, side.is_back));
            let primitive = json!({ "attributes": attributes, "indices": indices, "material": material });
            let name = name(scene, &side);
            let mesh = glb.push("meshes", json!({ "name": name, "primitives": [primitive] }));
            glb.push("nodes", json!({ "name": name, "mesh": mesh }));
        }
    }
    Ok(unlit)
}

/// The sides of a mesh that are seen: one where both show the same light, which is none.
fn sides(scene: &LoadedScene, draw: &LoadedDraw, pages: &Pages) -> Vec<Side> {
    let double_sided = scene.manifest.materials[draw.material as usize].double_sided;
    let side = |block: u32, is_back: bool| {
        let place = pages.places.get(block as usize).copied().flatten();
        let page = place.map(|place| place.page);
        Side { is_back, block, look: Look { material: draw.material, page, double_sided: false }, place }
    };
    let [front, back] = [side(draw.front, false), side(draw.back, true)];
    match (double_sided, front.place, back.place) {
        (false, ..) => vec![front],
        (true, None, None) => vec![Side { look: Look { double_sided: true, ..front.look }, ..front }],
        (true, ..) => vec![front, back],
    }
}

/// The triangles as they are seen from a side.
fn turned(triangles: &[[u32; 3]], is_back: bool) -> Vec<[u32; 3]> {
    triangles.iter().map(|&[a, b, c]| if is_back { [a, c, b] } else { [a, b, c] }).collect()
}

/// Name of a side: its block's, which says the mesh's path in the scene, else its material's.
fn name(scene: &LoadedScene, side: &Side) -> String {
    let blocks = scene.manifest.lightmap.as_ref().map_or(&[][..], |lightmap| &lightmap.blocks);
    let of_material = || scene.manifest.materials[side.look.material as usize].name.clone();
    blocks.get(side.block as usize).map_or_else(of_material, |block| block.name.clone())
}

/// Accessors that both sides of a mesh read.
struct Shared {
    position: usize,
    /// By the place of the map among [`uv_maps`]; at least one, as the lightmap's set is the second.
    uv: Vec<usize>,
    colour: Option<usize>,
}

impl Shared {
    fn write(glb: &mut Glb, scene: &LoadedScene, draw: &LoadedDraw) -> Self {
        let material = &scene.manifest.materials[draw.material as usize];
        let position = glb.vertices(&of(draw, |vertex| vertex.position_m), true);
        let mut maps = uv_maps(material);
        if maps.is_empty() {
            maps.push(None);
        }
        let uv =
            maps.into_iter().map(|map| glb.vertices(&of(draw, |vertex| moved_uv(map, vertex.uv)), false));
        let uv = uv.collect();
        let is_coloured = draw.vertices.iter().any(|vertex| vertex.colour != [1.0; 4]);
        let colour = is_coloured.then(|| glb.vertices(&of(draw, |vertex| vertex.colour), false));
        Self { position, uv, colour }
    }

    fn attributes(&self, glb: &mut Glb, (draw, side): (&LoadedDraw, &Side), atlas: Atlas<'_>) -> Value {
        let towards = if side.is_back { -1.0 } else { 1.0 };
        let normal = |vertex: &Vertex| {
            (towards * Vec3::from(vertex.normal).normalize_or(Vec3::Y)).to_array().map(|axis| axis + 0.0)
        };
        let mut attributes = Map::new();
        let mut set = |name: String, accessor: usize| attributes.insert(name, json!(accessor));
        set("POSITION".to_owned(), self.position);
        set("NORMAL".to_owned(), glb.vertices(&of(draw, normal), false));
        for (place, accessor) in self.uv.iter().enumerate() {
            set(format!("TEXCOORD_{}", uv_set(place, side.look.page)), *accessor);
        }
        if let Some(place) = &side.place {
            let page = atlas.pages.sizes[place.page as usize];
            let uv = |vertex: &Vertex| page_uv(vertex.lightmap_texel, place, page, atlas.scale);
            set("TEXCOORD_1".to_owned(), glb.vertices(&of(draw, uv), false));
        }
        if let Some(colour) = self.colour {
            set("COLOR_0".to_owned(), colour);
        }
        Value::Object(attributes)
    }
}

/// Coordinates in a page, 0..1 from its upper left corner, of a place in a block's texels.
pub fn page_uv(texel: [f32; 2], place: &Place, page: [u32; 2], scale: u32) -> [f32; 2] {
    let along = |axis: usize| {
        let inner = place.size[axis] - 2 * GUTTER;
        // No further than the rim goes: an engine is to read this block alone.
        let at = (f64::from(texel[axis]) * f64::from(scale)).clamp(0.0, f64::from(inner));
        ((f64::from(place.corner[axis] + GUTTER) + at) / f64::from(page[axis])) as f32
    };
    [along(0), along(1)]
}

fn of<const N: usize>(draw: &LoadedDraw, value: impl Fn(&Vertex) -> [f32; N]) -> Vec<[f32; N]> {
    draw.vertices.iter().map(value).collect()
}

/// Writes the cameras of a scene, a node each.
pub fn write_cameras(glb: &mut Glb, scene: &LoadedScene) {
    let [low, high] = scene.manifest.bounds_m.map(Vec3::from);
    let diagonal = f64::from((high - low).length().max(1e-3));
    let chosen = scene.manifest.framing.camera.iter().map(|chosen| &chosen.value);
    for camera in scene.manifest.cameras.iter().chain(chosen) {
        let Some(rotation) = looking(camera) else { continue };
        let far = 2.0 * (f64::from(Vec3::from(camera.eye_m).distance(low.midpoint(high))) + diagonal);
        let lens = match camera.orthographic_half_height_m {
            // Depth buffers of 24 bits tell little apart where the near plane lies nearer.
            None => json!({
                "type": "perspective",
                "perspective": { "yfov": camera.fov_y_rad, "znear": 1e-3 * diagonal, "zfar": far },
            }),
            Some(half) => {
                let sides = json!({ "xmag": half, "ymag": half, "znear": 0, "zfar": far });
                json!({ "type": "orthographic", "orthographic": sides })
            }
        };
        let index = glb.push("cameras", lens);
        let node = json!({
            "name": camera.name, "camera": index, "translation": camera.eye_m, "rotation": rotation.to_array(),
        });
        glb.push("nodes", node);
    }
}

/// The turn of a camera that looks along −z; `None` for one that looks nowhere.
fn looking(camera: &SceneCamera) -> Option<Quat> {
    let [eye, target, up] = [camera.eye_m, camera.target_m, camera.up].map(Vec3::from);
    let forward = (target - eye).try_normalize()?;
    let right = forward.cross(up).try_normalize()?;
    Some(Quat::from_mat3(&Mat3::from_cols(right, right.cross(forward), -forward)).normalize())
}
