//! Task `scene.draw`: chunks of meshes, with lightmap coordinates where there is a lightmap, and of the scene's textures.

use std::collections::BTreeMap;

use glam::Vec2;
use lightkiln_proto::chunk::{encode_geometry, encode_texture};
use lightkiln_proto::content::{Draw, Geometry};
use lightkiln_proto::jobs::TaskSpec;

use crate::lightmap::Charts;
use crate::lightmap::place::{blocks, sides};
use crate::scene::model::{MeshInstance, Scene, SceneImage, TextureUse};
use crate::scene::surface::normal_of;
use crate::task::{Context, Progress, TaskError, TaskOutput};
use crate::unwrap::UnwrappedTriangle;

/// Triangles after which a geometry chunk is closed; most triangles of a draw outside a lightmap.
const CHUNK_TRIANGLES: usize = 200_000;
/// Draws after which a geometry chunk is closed.
const CHUNK_DRAWS: usize = 1 << 15;

/// Runs the task: inputs `import/scene`, `import/details` and, for a lightmap, `unwrap/unwrap`; outputs `geometry/N`, `texture/N`.
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let (scene, _): (Scene, _) = context.decoded(crate::scene::ARTEFACT_MAGIC, crate::scene::ARTEFACT)?;
    let mut artefacts = match Charts::if_any(context)? {
        Some(charts) => geometry_chunks(draws_in_lightmap(&scene, &charts)?, context.progress)?,
        None => {
            let draws = scene.instances.iter().flat_map(|instance| draws_as_they_are(&scene, instance));
            geometry_chunks(draws, context.progress)?
        }
    };
    let (details, _): (Vec<SceneImage>, _) =
        context.decoded(crate::scene::DETAILS_MAGIC, crate::scene::DETAILS)?;
    for (index, image) in scene.images.iter().chain(&details).enumerate() {
        let bytes = encode_texture(&image.media_type, &image.bytes).map_err(|error| {
            TaskError::bad_input_from(format!("image '{}' cannot be stored", image.name), error)
        })?;
        artefacts.push((format!("texture/{index}"), bytes));
    }
    Ok(TaskOutput { artefacts, ..TaskOutput::default() })
}

/// Draws in chunks `geometry/N`.
fn geometry_chunks(
    draws: impl IntoIterator<Item = Draw>,
    progress: &Progress,
) -> Result<Vec<(String, Vec<u8>)>, TaskError> {
    let mut chunks = Vec::new();
    let (mut open, mut triangles) = (Geometry::default(), 0);
    let mut close = |open: &mut Geometry| -> Result<(), TaskError> {
        let bytes = encode_geometry(open)
            .map_err(|error| TaskError::bad_input_from("the scene's meshes cannot be stored", error))?;
        chunks.push((format!("geometry/{}", chunks.len()), bytes));
        *open = Geometry::default();
        Ok(())
    };
    for draw in draws {
        progress.check()?;
        triangles += draw.triangles.len();
        open.draws.push(draw);
        if triangles >= CHUNK_TRIANGLES || open.draws.len() >= CHUNK_DRAWS {
            triangles = 0;
            close(&mut open)?;
        }
    }
    if !open.draws.is_empty() {
        close(&mut open)?;
    }
    Ok(chunks)
}

/// A draw for each part of each instance's unwrap.
fn draws_in_lightmap<'a>(
    scene: &'a Scene,
    charts: &'a Charts,
) -> Result<impl Iterator<Item = Draw> + 'a, TaskError> {
    let mut keys = blocks(scene, charts)?.into_iter().map(|block| block.key);
    let parts =
        scene.instances.iter().zip(&charts.unwraps).enumerate().flat_map(|(index, (instance, unwrap))| {
            unwrap.blocks.iter().map(move |block| (index, instance, block))
        });
    Ok(parts.map(move |(index, instance, block)| {
        let mut side = || keys.next().expect("every side of a part has a block");
        let front = side();
        let back = (sides(scene, index) == 2).then(side);
        Draw { front: Some(front), back, ..draw_of(scene, instance, &block.triangles) }
    }))
}

/// An instance's own vertices and triangles, outside any lightmap.
pub fn draws_as_they_are<'a>(
    scene: &'a Scene,
    instance: &'a MeshInstance,
) -> impl Iterator<Item = Draw> + 'a {
    let source = Source::of(scene, instance);
    instance.triangles.chunks(CHUNK_TRIANGLES).map(move |triangles| {
        let mut draw = source.empty_draw();
        let mut seen: BTreeMap<u32, u32> = BTreeMap::new();
        let mut add = |vertex: u32| {
            *seen.entry(vertex).or_insert_with(|| {
                source.push_vertex(&mut draw, [vertex; 3], [1.0, 0.0, 0.0]);
                draw.position_m.len() as u32 - 1
            })
        };
        let triangles = triangles.iter().map(|corners| corners.map(&mut add)).collect();
        Draw { triangles, ..draw }
    })
}

/// Vertices and triangles of one part; vertices that agree in everything are shared.
fn draw_of(scene: &Scene, instance: &MeshInstance, triangles: &[UnwrappedTriangle]) -> Draw {
    let source = Source::of(scene, instance);
    let mut draw = source.empty_draw();
    let mut seen: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
    for triangle in triangles {
        let vertices = instance.triangles[triangle.source_triangle as usize];
        let mut corners = [0; 3];
        for (corner, slot) in corners.iter_mut().enumerate() {
            let texel = triangle.uv_texels[corner];
            let bits = texel.to_array().map(f32::to_bits);
            let add = |draw: &mut Draw, weights: [f32; 3]| {
                source.push_vertex(draw, vertices, weights);
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

/// An instance and what its vertices are drawn with.
struct Source<'a> {
    instance: &'a MeshInstance,
    base: Option<&'a TextureUse>,
    /// The texture whose UV set the draw has.
    texture: Option<&'a TextureUse>,
}

impl<'a> Source<'a> {
    fn of(scene: &'a Scene, instance: &'a MeshInstance) -> Self {
        let material = &scene.materials[instance.material_index as usize];
        let base = material.base_colour_texture.as_ref();
        Self { instance, base, texture: material.first_texture() }
    }

    fn empty_draw(&self) -> Draw {
        Draw { material: self.instance.material_index, ..Draw::default() }
    }

    /// Adds the point of a triangle of these `corners` at `weights`.
    fn push_vertex(&self, draw: &mut Draw, corners: [u32; 3], weights: [f32; 3]) {
        let instance = self.instance;
        let [wa, wb, wc] = weights;
        let [a, b, c] = corners.map(|vertex| instance.positions_m[vertex as usize]);
        draw.position_m.push((a * wa + b * wb + c * wc).to_array());
        draw.normal.push(normal_of(instance, corners, weights).to_array());
        if let Some(texture) = self.texture {
            let uvs = if texture.uv_set == 0 { &instance.uv0 } else { &instance.uv1 };
            let [a, b, c] = corners.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default());
            let uv = a * wa + b * wb + c * wc;
            // Only the base colour's transform is folded in; others are stated relative to it in the manifest.
            let folded = self.base.map_or(uv, |base| transformed(base.uv_transform, uv));
            draw.uv.push(folded.to_array());
        }
        if !instance.colours.is_empty() {
            let [a, b, c] = corners.map(|vertex| instance.colours[vertex as usize]);
            draw.colour.push([0, 1, 2, 3].map(|channel| a[channel] * wa + b[channel] * wb + c[channel] * wc));
        }
    }
}

fn transformed(rows: [[f32; 3]; 2], uv: Vec2) -> Vec2 {
    let [u, v] = rows.map(|[a, b, c]| a * uv.x + b * uv.y + c);
    Vec2::new(u, v)
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::chunk::decode_geometry;
    use lightkiln_proto::kinds::SceneTasks;
    use lightkiln_proto::settings::{Preset, SettingsGroup, TexelSettings};

    use super::*;
    use crate::kinds::{BakeKinds, Runner};
    use crate::task::{ArtefactSource, LocalRun};

    /// Corners of a triangle as bits: positions, normals, texture coordinates, colours.
    type Corners = [([u32; 3], [u32; 3], Option<[u32; 2]>, Option<[u32; 4]>); 3];

    /// Triangles of all draws, sorted; and how many draws lie in a lightmap.
    fn drawn(tasks: impl FnOnce(SceneTasks) -> SceneTasks) -> (Vec<Corners>, usize, usize) {
        let progress = Progress::new();
        let mut run = LocalRun::new(1 << 30, &progress);
        let bundle = run.shelf.put(include_bytes!("../../../tests/scenes/atrium.glb").to_vec());
        let plan = tasks(SceneTasks::of(bundle)).into_specs().collect();
        run.run(&Runner::new(&BakeKinds::new()), plan, |_| true, |_| {}).unwrap();
        let bytes = run.shelf.get(run.output("scene.draw", "geometry/0").unwrap()).unwrap();
        let draws = decode_geometry(&bytes).unwrap().draws;
        let corner = |draw: &Draw, vertex: u32| {
            let vertex = vertex as usize;
            let uv = draw.uv.get(vertex).map(|uv| uv.map(f32::to_bits));
            let colour = draw.colour.get(vertex).map(|colour| colour.map(f32::to_bits));
            (draw.position_m[vertex].map(f32::to_bits), draw.normal[vertex].map(f32::to_bits), uv, colour)
        };
        let of_draw = |draw: &Draw| -> Vec<Corners> {
            draw.triangles.iter().map(|triangle| triangle.map(|vertex| corner(draw, vertex))).collect()
        };
        let mut triangles: Vec<Corners> = draws.iter().flat_map(of_draw).collect();
        triangles.sort_unstable();
        (triangles, draws.iter().filter(|draw| draw.front.is_some()).count(), draws.len())
    }

    #[test]
    fn meshes_are_the_same_in_a_lightmap_and_outside() {
        let texels = TexelSettings::read(&Default::default(), Preset::Draft).unwrap();
        let (inside, in_lightmap, all) = drawn(|tasks| tasks.unwrapped(&texels));
        assert_eq!(in_lightmap, all);
        let (outside, in_lightmap, _) = drawn(|tasks| tasks);
        assert_eq!(in_lightmap, 0);
        assert!(inside.len() > 1000 && inside == outside);
        assert!(inside.iter().any(|corners| corners[0].2.is_some()), "no draw has texture coordinates");
    }
}
