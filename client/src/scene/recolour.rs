//! Colours of materials other than those that a bake has: transport holds none, so none is traced again.

use std::collections::HashSet;

use glam::Vec3;
use lightkiln_proto::manifest::{Manifest, Material};

use super::LoadedScene;
use super::draws::{LoadedDraw, Vertex};
use super::lightmap::NO_BLOCK;
use crate::error::{ClientError, Result};

/// Largest albedo, as in bakes: bounces in a whiter room would never end.
pub const ALBEDO_MAX: f32 = 0.98;
/// Names of materials that an error lists.
const NAMES: usize = 12;
/// Base colour from which on the albedo of textures can be told from that of receivers, which has 8 bits.
const TINTED_MIN: f32 = 1e-3;

/// Another base colour of a material.
#[derive(Clone, Debug, PartialEq)]
pub struct Recolour {
    /// Its name; all materials of that name have the colour.
    pub material: String,
    /// Linear base colour, 0 to 1, in place of the file's factor. Textures are multiplied in as before.
    pub base_colour: [f32; 3],
}

/// Colours of a scene's materials, and the change of their albedo. Empty: as baked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tints(Vec<Option<Tint>>);

/// Another colour of one material.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tint {
    base_colour: Vec3,
    /// Factor on the albedo of surfaces with textures or colours at vertices; 1 where it is 0.
    factor: Vec3,
}

/// Change of a receiver's albedo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Albedo {
    /// It is this: the surface has one colour.
    Is(Vec3),
    /// It is multiplied.
    Times(Vec3),
}

impl Albedo {
    /// The albedo of a receiver whose own is given.
    pub fn of(self, own: Vec3) -> Vec3 {
        match self {
            Self::Is(albedo) => albedo,
            Self::Times(factor) => (own * factor).min(Vec3::splat(ALBEDO_MAX)),
        }
    }
}

impl Tints {
    /// Other colours of a scene's materials. Errs for a name that no material has, for glass, whose colour is that of what passes it,
    /// and where a material with textures is to reflect a channel of which it has next to nothing.
    pub fn of(scene: &LoadedScene, colours: &[Recolour]) -> Result<Self> {
        check_among(scene.coloured_materials().map(|(_, material)| material), colours)?;
        let mut tints = vec![None; scene.manifest.materials.len()];
        let uneven: HashSet<u32> = {
            let draws = scene.draws.draws.iter();
            draws.filter(|draw| !is_even(scene, draw)).map(|draw| draw.material).collect()
        };
        for Recolour { material: name, base_colour } in colours {
            // A material of the same name of an object without a bake keeps its own colour.
            let materials = scene.coloured_materials();
            for (index, material) in materials.filter(|(_, material)| material.name == *name) {
                let old = Vec3::from_slice(&material.base_colour[..3]);
                let new = Vec3::from(*base_colour);
                for channel in (0..3).filter(|_| uneven.contains(&index)) {
                    if old[channel] < TINTED_MIN && new[channel] > 0.0 {
                        let which = ["red", "green", "blue"][channel];
                        return Err(refused(
                            name,
                            &format!(
                                "has next to no {which} in the bake, so that of its textures is not known; give 0, or bake the scene with that colour"
                            ),
                        ));
                    }
                }
                let is_there = old.cmpge(Vec3::splat(TINTED_MIN));
                let factor = Vec3::select(is_there, new / old, Vec3::ONE);
                tints[index as usize] = Some(Tint { base_colour: new, factor });
            }
        }
        Ok(Self(tints))
    }

    /// Likewise, of those colours alone whose names some of its materials have.
    pub fn of_named(scene: &LoadedScene, colours: &[Recolour]) -> Result<Self> {
        Self::of(scene, &named_in(scene, colours))
    }

    /// Change of the albedo in each block of the lightmap, by the mesh that reads it; `None` where it stays.
    pub fn by_block(&self, scene: &LoadedScene) -> Vec<Option<Albedo>> {
        let mut by_block = vec![None; scene.lightmap.blocks.len()];
        for draw in &scene.draws.draws {
            let Some(tint) = self.of_material(draw.material) else { continue };
            let albedo = if is_even(scene, draw) {
                Albedo::Is(tint.base_colour.min(Vec3::splat(ALBEDO_MAX)))
            } else {
                Albedo::Times(tint.factor)
            };
            for block in [draw.front, draw.back].into_iter().filter(|block| *block != NO_BLOCK) {
                by_block[block as usize] = Some(albedo);
            }
        }
        by_block
    }

    /// Base colour and alpha of a material.
    pub fn base_colour(&self, scene: &LoadedScene, material: u32) -> [f32; 4] {
        let [r, g, b, alpha] = scene.manifest.materials[material as usize].base_colour;
        let [r, g, b] = self.of_material(material).map_or([r, g, b], |tint| tint.base_colour.to_array());
        [r, g, b, alpha]
    }

    fn of_material(&self, material: u32) -> Option<Tint> {
        self.0.get(material as usize).copied().flatten()
    }
}

/// A mesh has one colour: neither a texture nor colours at vertices.
fn is_even(scene: &LoadedScene, draw: &LoadedDraw) -> bool {
    let white = |vertex: &Vertex| vertex.colour[..3] == [1.0; 3];
    let material = &scene.manifest.materials[draw.material as usize];
    material.base_colour_texture.is_none() && draw.vertices.iter().all(white)
}

/// Refuses what can be refused before anything but the manifest is there: colours out of range, unknown names, and glass.
pub fn check_recolours(manifest: &Manifest, colours: &[Recolour]) -> Result<()> {
    check_among(manifest.materials.iter(), colours)
}

/// Those colours whose names some of a scene's materials have.
pub(crate) fn named_in(scene: &LoadedScene, colours: &[Recolour]) -> Vec<Recolour> {
    let is_named =
        |colour: &&Recolour| scene.coloured_materials().any(|(_, material)| material.name == colour.material);
    colours.iter().filter(is_named).cloned().collect()
}

/// Refuses colours that no material can have, among those of a bake and of objects with bakes of their own.
pub(crate) fn check_among<'a>(
    materials: impl Iterator<Item = &'a Material> + Clone,
    colours: &[Recolour],
) -> Result<()> {
    for Recolour { material: name, base_colour } in colours {
        if !base_colour.iter().all(|channel| (0.0..=1.0).contains(channel)) {
            return Err(refused(name, "takes a linear colour with channels 0 to 1"));
        }
        let mut named = materials.clone().filter(|material| material.name == *name).peekable();
        if named.peek().is_none() {
            return Err(refused(name, &format!("is none of the bake's: {}", names(materials.clone()))));
        }
        if named.any(|material| material.glass.is_some()) {
            return Err(refused(name, "is of glass: its colour is baked; bake the scene with another one"));
        }
    }
    Ok(())
}

fn refused(name: &str, problem: &str) -> ClientError {
    ClientError::Argument { what: format!("material '{name}'"), problem: problem.to_owned() }
}

/// Names of a bake's materials, the first of many.
fn names<'a>(materials: impl Iterator<Item = &'a Material>) -> String {
    let mut names: Vec<&str> = materials.map(|material| material.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let more = names.len().saturating_sub(NAMES);
    names.truncate(NAMES);
    let listed = names.join("', '");
    if more > 0 { format!("'{listed}', and {more} more") } else { format!("'{listed}'") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::Light as _;
    use crate::fixture;

    fn colour(material: &str, base_colour: [f32; 3]) -> Recolour {
        Recolour { material: material.to_owned(), base_colour }
    }

    #[test]
    fn receivers_of_a_recoloured_material_alone_have_its_albedo() {
        let (scene, light) = fixture::prt_light(&fixture::prt_contents());
        let material = &scene.manifest.materials[0];
        let tints = Tints::of(&scene, &[colour(&material.name, [0.1, 0.2, 1.0])]).unwrap();
        let new = light.tinted_albedo(&scene, &tints).unwrap();
        let by_block = tints.by_block(&scene);
        let (mut changed, mut kept) = (0, 0);
        for (block, albedo) in by_block.iter().enumerate() {
            let [width, height] = light.transport.slots.size(block as u32).unwrap();
            for texel in (0..height).flat_map(|y| (0..width).map(move |x| [x as u16, y as u16])) {
                let Some(slot) = light.transport.slots.slot(block as u32, texel) else { continue };
                let [was, is] =
                    [&light.transport.receivers.albedo, &new].map(|of| of[slot as usize].truncate());
                if albedo.is_some() {
                    assert_eq!(is, Vec3::new(0.1, 0.2, ALBEDO_MAX));
                    changed += 1;
                } else {
                    assert_eq!(was, is);
                    kept += 1;
                }
            }
        }
        assert!(changed > 20 && kept > 20, "{changed} {kept}");
        assert_eq!(Tints::of(&scene, &[]).unwrap().by_block(&scene), vec![None; by_block.len()]);
    }

    #[test]
    fn textures_and_colours_at_vertices_are_multiplied_and_one_colour_is_given_outright() {
        let (mut scene, _) = fixture::prt_light(&fixture::prt_contents());
        let name = scene.manifest.materials[0].name.clone();
        let of_first = scene.draws.draws.iter().position(|draw| draw.material == 0).unwrap();
        let front = scene.draws.draws[of_first].front as usize;
        // White is baked as dark as albedo may be, and black is black.
        scene.manifest.materials[0].base_colour = [1.0, 0.0, 1e-4, 1.0];
        let colours = [colour(&name, [0.5, 0.25, 0.75])];
        let tints = Tints::of(&scene, &colours).unwrap();
        assert_eq!(tints.by_block(&scene)[front], Some(Albedo::Is(Vec3::new(0.5, 0.25, 0.75))));
        assert_eq!(tints.base_colour(&scene, 0), [0.5, 0.25, 0.75, 1.0]);
        scene.draws.draws[of_first].vertices[0].colour = [0.5, 1.0, 1.0, 1.0];
        let refused = Tints::of(&scene, &colours).unwrap_err().to_string();
        assert!(refused.contains("next to no green"), "{refused}");
        let tints = Tints::of(&scene, &[colour(&name, [0.5, 0.0, 0.0])]).unwrap();
        let found = tints.by_block(&scene)[front];
        assert_eq!(found, Some(Albedo::Times(Vec3::new(0.5, 1.0, 1.0))));
        assert_eq!(
            Albedo::Times(Vec3::splat(3.0)).of(Vec3::new(0.2, 0.3, 0.4)),
            Vec3::new(3.0 * 0.2, 3.0 * 0.3, ALBEDO_MAX)
        );
    }

    #[test]
    fn colours_that_cannot_be_are_refused_with_the_reason() {
        let (scene, _) = fixture::prt_light(&fixture::prt_contents());
        let name = scene.manifest.materials[0].name.clone();
        let refused = |scene: &LoadedScene, of: &str, rgb: [f32; 3]| {
            Tints::of(scene, &[colour(of, rgb)]).unwrap_err().to_string()
        };
        let unknown = refused(&scene, "no such", [0.5; 3]);
        assert!(unknown.contains("'no such'") && unknown.contains(&name), "{unknown}");
        for wrong in [[1.5, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [-0.1, 0.0, 0.0]] {
            assert!(refused(&scene, &name, wrong).contains("0 to 1"));
        }
        let glazed = crate::tests::facing::glazed_bake().scene;
        let glass = glazed.manifest.materials.iter().find(|material| material.glass.is_some()).unwrap();
        assert!(refused(&glazed, &glass.name, [0.5; 3]).contains("glass"));
    }
}
