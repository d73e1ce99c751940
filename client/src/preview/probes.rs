//! Probes in free space as they stand: white spheres in the light that they have, or coloured by what they see.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::Material;

use super::components::components;
use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};
use crate::scene::{Object, Rigid};

/// Radius of a sphere over the step of the lattice.
const RADIUS: f32 = 0.06;
/// Times that the faces of an octahedron are cut into four.
const CUTS: usize = 2;
/// Colours of distances, the nearest first.
const DEPTHS: [[f32; 3]; 8] = [
    [0.8, 0.02, 0.02],
    [0.8, 0.2, 0.02],
    [0.8, 0.45, 0.03],
    [0.7, 0.7, 0.05],
    [0.3, 0.6, 0.1],
    [0.08, 0.5, 0.3],
    [0.04, 0.3, 0.6],
    [0.03, 0.06, 0.7],
];
/// Colours of components, that of the most probes first; they repeat.
const COMPONENTS: [[f32; 3]; 7] = [
    [0.8; 3],
    [0.8, 0.05, 0.05],
    [0.05, 0.15, 0.8],
    [0.05, 0.6, 0.1],
    [0.8, 0.6, 0.03],
    [0.6, 0.05, 0.6],
    [0.03, 0.6, 0.6],
];

/// Colours of probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeColours {
    /// White.
    White,
    /// By how far their depth maps tell the nearest surface along each direction: red where it is near, over yellow to blue from twice their
    /// distance from each other on.
    Depth,
    /// By component: white for the one with most probes.
    Components,
}

/// An object of all probes of a bake, to be put into it where it stands. Errs for a kind without light in free space.
pub fn probe_spheres(bake: &LoadedBake, colours: ProbeColours) -> Result<Object> {
    let space = bake.light.free_space().ok_or_else(|| no_probes(bake))?;
    let (directions, faces) = sphere();
    let radius_m = RADIUS * space.spacing_m();
    let components = if colours == ProbeColours::Components { components(space) } else { Vec::new() };
    let palette: Vec<[f32; 3]> = match colours {
        ProbeColours::White => vec![[1.0; 3]],
        ProbeColours::Depth => DEPTHS.to_vec(),
        ProbeColours::Components => COMPONENTS.to_vec(),
    };
    let mut draws: Vec<Draw> =
        (0..palette.len()).map(|material| Draw { material: material as u32, ..Draw::default() }).collect();
    for (position_m, probe) in space.positions_m().iter().zip(0..) {
        let colour = |face: &[u32; 3]| match colours {
            ProbeColours::White => 0,
            ProbeColours::Components => components[probe as usize] as usize % COMPONENTS.len(),
            ProbeColours::Depth => {
                let middle: Vec3 = face.iter().map(|corner| directions[*corner as usize]).sum();
                let share = 0.5 * space.distance_m(probe, middle.normalize()) / space.spacing_m();
                ((share * DEPTHS.len() as f32) as usize).min(DEPTHS.len() - 1)
            }
        };
        let mut firsts = vec![None; draws.len()];
        for face in &faces {
            let draw = &mut draws[colour(face)];
            let first = *firsts[draw.material as usize].get_or_insert_with(|| {
                let first = draw.position_m.len() as u32;
                let at = |direction: &Vec3| (position_m.truncate() + radius_m * *direction).to_array();
                draw.position_m.extend(directions.iter().map(at));
                draw.normal.extend(directions.iter().map(Vec3::to_array));
                first
            });
            draw.triangles.push(face.map(|corner| first + corner));
        }
    }
    let shape = Arc::new(Rigid(draws.into_iter().filter(|draw| !draw.triangles.is_empty()).collect()));
    let materials = palette.into_iter().map(|colour| plain_material("probe", colour)).collect();
    Ok(Object { name: "probes".to_owned(), materials, textures: Vec::new(), shape })
}

/// A bake's kind has no light in free space.
pub fn no_probes(bake: &LoadedBake) -> ClientError {
    let text = format!("kind {}", bake.scene.manifest.kind);
    let problem = "has no probes to show; bake the scene with a kind that has; 'kiln settings' lists kinds";
    ClientError::Source { text, problem: problem.to_owned() }
}

/// A matt material of one colour.
pub fn plain_material(name: &str, [red, green, blue]: [f32; 3]) -> Material {
    Material {
        name: name.to_owned(),
        base_colour: [red, green, blue, 1.0],
        base_colour_texture: None,
        emissive: [0.0; 3],
        emissive_texture: None,
        emitter: None,
        alpha_cutoff: None,
        glass: None,
        normal_map: None,
        specular: None,
        double_sided: false,
    }
}

/// Corners and triangles of a sphere of radius 1, seen from outside.
fn sphere() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let mut corners: Vec<Vec3> = Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]).collect();
    let mut faces = Vec::new();
    for signs in 0..8_u32 {
        let [x, y, z] = [0, 1, 2].map(|axis| 2 * axis + (signs >> axis & 1));
        faces.push(if signs.count_ones().is_multiple_of(2) { [x, y, z] } else { [x, z, y] });
    }
    for _ in 0..CUTS {
        let mut finer = Vec::new();
        for [a, b, c] in faces {
            let middles = [[a, b], [b, c], [c, a]].map(|[from, to]| {
                corners.push((corners[from as usize] + corners[to as usize]).normalize());
                corners.len() as u32 - 1
            });
            let [ab, bc, ca] = middles;
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces = finer;
    }
    (corners, faces)
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::fixture;
    use crate::preview::{Backend, View, render};
    use crate::scene::Stance;

    #[test]
    fn spheres_look_outwards() {
        let (corners, faces) = sphere();
        assert_eq!(faces.len(), 8 << (2 * CUTS));
        for face in faces {
            let [a, b, c] = face.map(|corner| corners[corner as usize]);
            assert!((b - a).cross(c - a).dot(a + b + c) > 0.0, "{a} {b} {c}");
            assert!([a, b, c].iter().all(|corner| (corner.length() - 1.0).abs() < 1e-6));
        }
    }

    #[test]
    fn spheres_stand_where_probes_do_and_have_their_light() {
        let mut bake = fixture::field_bake(true);
        let object = probe_spheres(&bake, ProbeColours::White).unwrap();
        let places = bake.light.free_space().unwrap().positions_m().to_vec();
        let draws = object.shape.draws(0, 0.0).unwrap();
        let spheres = draws[0].position_m.chunks_exact(sphere().0.len());
        assert_eq!(spheres.len(), places.len());
        for (sphere, place) in spheres.zip(places) {
            let middle: Vec3 = sphere[..6].iter().map(|at| Vec3::from(*at)).sum::<Vec3>() / 6.0;
            assert!(middle.distance(place.truncate()) < 1e-5, "{middle} {place}");
        }
        let view = crate::tests::view_of(&bake);
        let drawn = |bake: &LoadedBake, objects: Vec<Stance>| -> Vec<Vec4> {
            let view = View { objects, samples: 1, ..view.clone() };
            let linear = render(bake, &view, Backend::Cpu).unwrap().linear;
            linear.into_iter().map(|radiance| Vec3::from(radiance).extend(1.0)).collect()
        };
        let without = drawn(&bake, Vec::new());
        bake.add_object(object).unwrap();
        let with = drawn(&bake, vec![Stance::default()]);
        let changed = with.iter().zip(&without).filter(|(with, without)| with != without).count();
        let lit = with.iter().zip(&without).filter(|(with, without)| with != without && with.x > 0.0).count();
        assert!(changed > 50 && lit > changed / 2, "{lit} of {changed} pixels");
        let plain = fixture::prt_bake(&fixture::prt_contents());
        let refused = probe_spheres(&plain, ProbeColours::Depth);
        assert!(refused.unwrap_err().to_string().contains("no probes to show"));
    }

    #[test]
    fn spheres_are_red_towards_what_is_near() {
        let bake = fixture::field_bake(true);
        let space = bake.light.free_space().unwrap();
        let object = probe_spheres(&bake, ProbeColours::Depth).unwrap();
        let draws = object.shape.draws(0, 0.0).unwrap();
        let triangles: usize = draws.iter().map(|draw| draw.triangles.len()).sum();
        assert_eq!(triangles, space.positions_m().len() * (8 << (2 * CUTS)));
        let distance_m = |draw: &Draw, triangle: &[u32; 3]| {
            let corners = triangle.map(|corner| Vec3::from(draw.position_m[corner as usize]));
            let middle = corners.iter().sum::<Vec3>() / 3.0;
            let near = |probe: &usize| space.positions_m()[*probe].truncate().distance(middle);
            let probes = 0..space.positions_m().len();
            let probe = probes.min_by(|a, b| near(a).total_cmp(&near(b))).unwrap();
            let way = (middle - space.positions_m()[probe].truncate()).normalize();
            space.distance_m(probe as u32, way)
        };
        for draw in draws.iter() {
            let of_class = 0.25 * draw.material as f32 * space.spacing_m();
            for triangle in draw.triangles.iter().step_by(29) {
                let found_m = distance_m(draw, triangle);
                let above_m = if draw.material as usize + 1 == DEPTHS.len() { f32::INFINITY } else { 0.26 };
                assert!(found_m > of_class - 0.01 && found_m <= of_class + above_m, "{found_m}, {of_class}");
            }
        }
    }
}
