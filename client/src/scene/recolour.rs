//! Colours of materials other than those that a bake has: transport holds none, so none is traced again.

use glam::Vec3;

use super::LoadedScene;
use super::lightmap::NO_BLOCK;
use crate::error::{ClientError, Result};

/// Largest albedo, as in bakes: bounces in a whiter room would never end.
pub const ALBEDO_MAX: f32 = 0.98;
/// Names of materials that an error lists.
const NAMES: usize = 12;

/// Another base colour of a material.
#[derive(Clone, Debug, PartialEq)]
pub struct Recolour {
    /// Its name; all materials of that name have the colour.
    pub material: String,
    /// Linear base colour, 0 to 1, in place of the file's factor. Textures are multiplied in as before.
    pub base_colour: [f32; 3],
}

/// Factors on materials' base colours; 1 where there is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tints(Vec<Vec3>);

impl Tints {
    /// Factors that give a scene's materials other colours. Errs for a name that no material has, for glass, whose colour is that of
    /// what passes it, and where a material reflects nothing of a channel that it is to reflect.
    pub fn of(scene: &LoadedScene, colours: &[Recolour]) -> Result<Self> {
        let mut tints = vec![Vec3::ONE; scene.manifest.materials.len()];
        for Recolour { material: name, base_colour } in colours {
            let refused =
                |problem: String| ClientError::Argument { what: format!("material '{name}'"), problem };
            if !base_colour.iter().all(|channel| (0.0..=1.0).contains(channel)) {
                return Err(refused("takes a linear colour with channels 0 to 1".to_owned()));
            }
            let materials = scene.manifest.materials.iter().zip(&mut tints);
            let mut named = materials.filter(|(material, _)| material.name == *name).peekable();
            if named.peek().is_none() {
                return Err(refused(format!("is none of the bake's: {}", names(scene))));
            }
            for (material, tint) in named {
                if material.glass.is_some() {
                    let problem = "is of glass: its colour is baked; bake the scene with another one";
                    return Err(refused(problem.to_owned()));
                }
                for channel in 0..3 {
                    let (old, new) = (material.base_colour[channel], base_colour[channel]);
                    if old <= 0.0 && new > 0.0 {
                        let which = ["red", "green", "blue"][channel];
                        return Err(refused(format!(
                            "has no {which} in the bake, so textures of it are not known; give 0, or bake the scene with that colour"
                        )));
                    }
                    tint[channel] = if old > 0.0 { new / old } else { 1.0 };
                }
            }
        }
        Ok(Self(tints))
    }

    /// The factor of a material.
    pub fn of_material(&self, material: u32) -> Vec3 {
        self.0.get(material as usize).copied().unwrap_or(Vec3::ONE)
    }

    /// The factor of each block of the lightmap: that of the mesh which reads it.
    pub fn by_block(&self, scene: &LoadedScene) -> Vec<Vec3> {
        let mut by_block = vec![Vec3::ONE; scene.lightmap.blocks.len()];
        for draw in &scene.draws.draws {
            for block in [draw.front, draw.back].into_iter().filter(|block| *block != NO_BLOCK) {
                by_block[block as usize] = self.of_material(draw.material);
            }
        }
        by_block
    }

    /// Base colour and alpha of a material.
    pub fn base_colour(&self, scene: &LoadedScene, material: u32) -> [f32; 4] {
        let [r, g, b, alpha] = scene.manifest.materials[material as usize].base_colour;
        let tint = self.of_material(material);
        [r * tint.x, g * tint.y, b * tint.z, alpha]
    }
}

/// Names of a scene's materials, the first of many.
fn names(scene: &LoadedScene) -> String {
    let mut names: Vec<&str> =
        scene.manifest.materials.iter().map(|material| material.name.as_str()).collect();
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
    use crate::fixture;

    fn colour(material: &str, base_colour: [f32; 3]) -> Recolour {
        Recolour { material: material.to_owned(), base_colour }
    }

    #[test]
    fn receivers_of_a_recoloured_material_alone_have_its_albedo() {
        let (scene, light) = fixture::prt_light(&fixture::prt_contents());
        let material = &scene.manifest.materials[0];
        let old = Vec3::from_slice(&material.base_colour[..3]);
        let tints = Tints::of(&scene, &[colour(&material.name, [0.1, 0.2, 0.9])]).unwrap();
        let new = crate::bake::Light::tinted_albedo(&light, &scene, &tints).unwrap();
        let by_block = tints.by_block(&scene);
        let (mut changed, mut kept) = (0, 0);
        for (block, tint) in by_block.iter().enumerate() {
            let [width, height] = light.transport.slots.size(block as u32).unwrap();
            for texel in (0..height).flat_map(|y| (0..width).map(move |x| [x as u16, y as u16])) {
                let Some(slot) = light.transport.slots.slot(block as u32, texel) else { continue };
                let [was, is] =
                    [&light.transport.receivers.albedo, &new].map(|of| of[slot as usize].truncate());
                if *tint == Vec3::ONE {
                    assert_eq!(was, is);
                    kept += 1;
                } else {
                    let wanted = (was * Vec3::new(0.1, 0.2, 0.9) / old).min(Vec3::splat(ALBEDO_MAX));
                    assert!(is.distance(wanted) < 1e-5 && is != was, "{was} {is} {wanted}");
                    changed += 1;
                }
            }
        }
        assert!(changed > 20 && kept > 20, "{changed} {kept}");
        assert_eq!(Tints::of(&scene, &[]).unwrap().by_block(&scene), vec![Vec3::ONE; by_block.len()]);
    }

    #[test]
    fn colours_that_cannot_be_are_refused_with_the_reason() {
        let (mut scene, _) = fixture::prt_light(&fixture::prt_contents());
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
        scene.manifest.materials[0].base_colour[1] = 0.0;
        assert!(refused(&scene, &name, [0.5; 3]).contains("no green"));
        assert!(Tints::of(&scene, &[colour(&name, [0.5, 0.0, 0.5])]).is_ok());
    }
}
