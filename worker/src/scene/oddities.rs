//! Scenes that bake as they stand, but hardly as they are meant.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use super::inside_out::inside_out;
use super::model::{Material, MeshInstance, Scene, Warning};
use super::surface::{MAX_ALBEDO, stopped};

/// Materials that a warning lists by name.
const LISTED_MAX: usize = 8;

/// Warnings of a whole scene.
pub(super) fn oddities(scene: &Scene) -> Vec<Warning> {
    [clamped_albedos(scene), copies(scene), inside_out(scene)].into_iter().flatten().collect()
}

/// Materials without texture whose albedo is clamped; under a texture, only texels that are whiter than the clamp are
/// touched.
fn clamped_albedos(scene: &Scene) -> Option<Warning> {
    let is_too_white = |material: &Material| {
        let transmission = material.glass.as_ref().map_or(0.0, |glass| glass.transmission);
        let [r, g, b] = stopped(material, material.base_colour, transmission).albedo;
        material.base_colour_texture.is_none() && r.max(g).max(b) > MAX_ALBEDO
    };
    let too_white = scene.materials.iter().enumerate().filter(|(_, material)| is_too_white(material));
    let places: Vec<String> =
        too_white.filter_map(|(index, material)| place(scene, index, material)).collect();
    let listed = places.iter().take(LISTED_MAX).map(String::as_str).collect::<Vec<_>>().join(", ");
    let more = places.len().saturating_sub(LISTED_MAX);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!places.is_empty()).then(|| Warning {
        code: "albedo-clamped".into(),
        message: format!(
            "{} more than {MAX_ALBEDO} of the light, clamped to that, as bounces would never end: \
             {listed}{more}; a base colour below it is baked as it stands",
            counted(places.len(), "material reflects", "materials reflect")
        ),
    })
}

/// A material with the first mesh that it is on; none if nothing has it.
fn place(scene: &Scene, index: usize, material: &Material) -> Option<String> {
    let mut on = scene.instances.iter().filter(|instance| instance.material_index as usize == index);
    let first = on.next()?;
    let more = match on.count() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Some(format!("'{}' on '{}'{more}", material.name, first.path))
}

/// Meshes that lie exactly in one place: each has receivers of its own, which nobody can tell apart.
fn copies(scene: &Scene) -> Option<Warning> {
    let mut by_hash: BTreeMap<u64, Vec<&MeshInstance>> = BTreeMap::new();
    for instance in &scene.instances {
        by_hash.entry(hash_of(instance)).or_default().push(instance);
    }
    let copies_of = |alike: &Vec<&MeshInstance>| {
        let is_copy = |other: &&&MeshInstance| {
            other.positions_m == alike[0].positions_m && other.triangles == alike[0].triangles
        };
        (alike.iter().filter(is_copy).count(), alike[0].path.clone())
    };
    let found: Vec<(usize, String)> =
        by_hash.values().map(copies_of).filter(|(count, _)| *count > 1).collect();
    let (most, path) = found.iter().max_by_key(|(count, path)| (*count, std::cmp::Reverse(path.clone())))?;
    let needless: usize = found.iter().map(|(count, _)| count - 1).sum();
    Some(Warning {
        code: "copies-in-one-place".into(),
        message: format!(
            "{} exactly where another one does, such as the {most} of '{path}': each takes texels, time and bytes, and \
             they flicker where their materials differ; remove all but one of each",
            counted(needless, "mesh lies", "meshes lie")
        ),
    })
}

/// Equal for meshes in one place.
fn hash_of(instance: &MeshInstance) -> u64 {
    let mut hasher = DefaultHasher::new();
    for position in &instance.positions_m {
        position.to_array().map(f32::to_bits).hash(&mut hasher);
    }
    instance.triangles.hash(&mut hasher);
    hasher.finish()
}

fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use glam::{Mat4, Vec3};

    use super::*;

    fn instance(path: &str, material_index: u32, x: f32) -> MeshInstance {
        MeshInstance {
            path: path.into(),
            material_index,
            positions_m: vec![Vec3::new(x, 0.0, 0.0), Vec3::new(x, 1.0, 0.0), Vec3::new(x, 0.0, 1.0)],
            normals: vec![Vec3::X; 3],
            uv0: Vec::new(),
            uv1: Vec::new(),
            colours: Vec::new(),
            triangles: vec![[0, 1, 2]],
            world_from_object: Mat4::IDENTITY,
            lit_by: None,
        }
    }

    fn material(name: &str, grey: f32) -> Material {
        Material::opaque(name, [grey; 3])
    }

    fn scene(instances: Vec<MeshInstance>) -> Scene {
        let materials = vec![material("wall", 0.5), material("default", 1.0), material("unused", 1.0)];
        Scene { instances, materials, ..Scene::default() }
    }

    #[test]
    fn clamped_material_is_told_with_what_it_is_on() {
        let on =
            vec![instance("hall/box/0", 0, 0.0), instance("lamp/0", 1, 1.0), instance("shade/0", 1, 2.0)];
        let found = oddities(&scene(on));
        let [clamped] = &found[..] else { panic!("{found:?}") };
        assert!(clamped.message.starts_with("1 material reflects more than"), "{}", clamped.message);
        assert!(clamped.message.contains("'default' on 'lamp/0' and 1 more"), "{}", clamped.message);
        assert_eq!(oddities(&scene(vec![instance("hall/box/0", 0, 0.0)])), []);
    }

    #[test]
    fn meshes_in_one_place_are_counted_and_named() {
        let mut many: Vec<_> = (0..87).map(|number| instance(&format!("leaf/0#{number}"), 0, 0.0)).collect();
        many.push(instance("stem/0", 0, 1.0));
        let found = oddities(&scene(many));
        let [copies] = &found[..] else { panic!("{found:?}") };
        assert!(copies.message.starts_with("86 meshes lie exactly where another one does"), "{found:?}");
        assert!(copies.message.contains("the 87 of 'leaf/0#0'"), "{found:?}");
    }
}
