//! Task `scene.draw`: chunks of meshes with lightmap coordinates, and of the scene's textures.

use std::collections::BTreeMap;

use glam::Vec2;
use lightkiln_proto::chunk::{encode_geometry, encode_texture};
use lightkiln_proto::content::{Draw, Geometry};
use lightkiln_proto::jobs::TaskSpec;

use crate::lightmap::Charts;
use crate::lightmap::place::{blocks, sides};
use crate::scene::model::{Material, MeshInstance, Scene, TextureUse};
use crate::scene::surface::normal_at;
use crate::task::{Context, TaskError, TaskOutput};
use crate::unwrap::UnwrappedTriangle;

/// Triangles after which a geometry chunk is closed.
const CHUNK_TRIANGLES: usize = 200_000;

/// Runs the task: inputs `import/scene`, `unwrap/unwrap`; outputs `geometry/N`, `texture/N`.
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let (scene, _): (Scene, _) = context.decoded(crate::scene::ARTEFACT_MAGIC, crate::scene::ARTEFACT)?;
    let charts = Charts::of(context)?;
    let mut artefacts = geometry_chunks(&scene, &charts)?;
    for (index, image) in scene.images.iter().enumerate() {
        let bytes = encode_texture(&image.media_type, &image.bytes).map_err(|error| {
            TaskError::bad_input_from(format!("image '{}' cannot be stored", image.name), error)
        })?;
        artefacts.push((format!("texture/{index}"), bytes));
    }
    Ok(TaskOutput { artefacts, ..TaskOutput::default() })
}

/// Draws of all blocks in chunks `geometry/N`.
fn geometry_chunks(scene: &Scene, charts: &Charts) -> Result<Vec<(String, Vec<u8>)>, TaskError> {
    let blocks = blocks(scene, charts)?;
    let mut next_block = blocks.iter().map(|block| block.key);
    let mut chunks = Vec::new();
    let (mut open, mut triangles) = (Geometry::default(), 0);
    let mut close = |open: &mut Geometry| -> Result<(), TaskError> {
        let bytes = encode_geometry(open)
            .map_err(|error| TaskError::bad_input_from("the scene's meshes cannot be stored", error))?;
        chunks.push((format!("geometry/{}", chunks.len()), bytes));
        *open = Geometry::default();
        Ok(())
    };
    for (index, (instance, unwrap)) in scene.instances.iter().zip(&charts.unwraps).enumerate() {
        let material = &scene.materials[instance.material_index as usize];
        for block in &unwrap.blocks {
            let mut side = || next_block.next().expect("every side of a part has a block");
            let front = side();
            let back = (sides(scene, index) == 2).then(side);
            let draw = draw_of(instance, material, &block.triangles);
            triangles += draw.triangles.len();
            open.draws.push(Draw { material: instance.material_index, front, back, ..draw });
            if triangles >= CHUNK_TRIANGLES {
                triangles = 0;
                close(&mut open)?;
            }
        }
    }
    if !open.draws.is_empty() {
        close(&mut open)?;
    }
    Ok(chunks)
}

/// Vertices and triangles of one part; vertices that agree in everything are shared.
fn draw_of(instance: &MeshInstance, material: &Material, triangles: &[UnwrappedTriangle]) -> Draw {
    let texture = material.base_colour_texture.as_ref().or(material.emissive_texture.as_ref());
    let mut draw = Draw::default();
    let mut seen: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
    for triangle in triangles {
        let vertices = instance.triangles[triangle.source_triangle as usize];
        let mut corners = [0; 3];
        for (corner, slot) in corners.iter_mut().enumerate() {
            let texel = triangle.uv_texels[corner];
            let bits = texel.to_array().map(f32::to_bits);
            let add = |draw: &mut Draw, weights: [f32; 3]| {
                push_vertex(draw, instance, texture, material, triangle.source_triangle as usize, weights);
                draw.lightmap_texel.push(texel.to_array());
                draw.position_m.len() as u32 - 1
            };
            *slot = match triangle.piece_corners.as_deref() {
                // Corners of a cut triangle lie on no vertex of the mesh.
                Some(pieces) => add(&mut draw, pieces[corner].to_array()),
                None => {
                    let mut weights = [0.0; 3];
                    weights[corner] = 1.0;
                    *seen.entry((vertices[corner], bits)).or_insert_with(|| add(&mut draw, weights))
                }
            };
        }
        draw.triangles.push(corners);
    }
    draw
}

fn push_vertex(
    draw: &mut Draw,
    instance: &MeshInstance,
    texture: Option<&TextureUse>,
    material: &Material,
    triangle: usize,
    weights: [f32; 3],
) {
    let corners = instance.triangles[triangle];
    let [wa, wb, wc] = weights;
    let [a, b, c] = corners.map(|vertex| instance.positions_m[vertex as usize]);
    draw.position_m.push((a * wa + b * wb + c * wc).to_array());
    draw.normal.push(normal_at(instance, triangle, weights).to_array());
    if let Some(texture) = texture {
        let uvs = if texture.uv_set == 0 { &instance.uv0 } else { &instance.uv1 };
        let [a, b, c] = corners.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default());
        let uv = a * wa + b * wb + c * wc;
        // Only the base colour's transform is folded in; others are stated relative to it in the manifest.
        let folded =
            material.base_colour_texture.as_ref().map_or(uv, |base| transformed(base.uv_transform, uv));
        draw.uv.push(folded.to_array());
    }
    if !instance.colours.is_empty() {
        let [a, b, c] = corners.map(|vertex| instance.colours[vertex as usize]);
        draw.colour.push([0, 1, 2, 3].map(|channel| a[channel] * wa + b[channel] * wb + c[channel] * wc));
    }
}

fn transformed(rows: [[f32; 3]; 2], uv: Vec2) -> Vec2 {
    let [u, v] = rows.map(|[a, b, c]| a * uv.x + b * uv.y + c);
    Vec2::new(u, v)
}
