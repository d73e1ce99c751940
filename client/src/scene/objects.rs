//! Objects that move: meshes beside a bake's, drawn and lit by lights, that stand in all shadow maps. No light of theirs is baked.

use std::error::Error;
use std::fmt::Debug;
use std::sync::Arc;

use glam::{Affine3A, EulerRot, Mat3, Quat, Vec3};
use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::Material;
pub use lightkiln_proto::scene::Stance;

use super::draws::{LoadedDraw, Vertex, checked};
use super::lightmap::NO_BLOCK;
use super::{LoadedScene, READ_TWICE, Texture, encoded};
use crate::error::{ClientError, Result};

/// Most objects beside a bake.
const OBJECTS_MAX: usize = 256;
/// Steps by which the scene's bounds grow with an object beyond them, of which so many are the bake's diagonal.
const BOUNDS_STEPS: f32 = 8.0;

/// Meshes of an object by time, in its own space.
pub trait ObjectShape: Debug + Send + Sync {
    /// Meshes at a time, in seconds, of an animation, counted from 0. They are as many, of as many vertices and triangles, at all times.
    fn draws(&self, clip: u32, time_s: f32) -> std::result::Result<Vec<Draw>, Box<dyn Error + Send + Sync>>;

    /// Length of an animation in seconds; 0 where there is none.
    fn length_s(&self, clip: u32) -> f32 {
        let _ = clip;
        0.0
    }
}

/// Meshes that are the same at all times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rigid(pub Vec<Draw>);

impl ObjectShape for Rigid {
    fn draws(&self, _: u32, _: f32) -> std::result::Result<Vec<Draw>, Box<dyn Error + Send + Sync>> {
        Ok(self.0.clone())
    }
}

/// An object, to be put beside a bake. Its materials and textures have their own numbers, from 0.
#[derive(Clone, Debug)]
pub struct Object {
    /// Name for messages, and for words of a command line: the file, if it is of one.
    pub name: String,
    /// Materials; an emissive one is drawn bright, and lights nothing.
    pub materials: Vec<Material>,
    /// Textures that the materials name.
    pub textures: Vec<Texture>,
    /// Its meshes.
    pub shape: Arc<dyn ObjectShape>,
}

/// An object beside a bake.
#[derive(Clone, Debug)]
pub(super) struct PlacedObject {
    name: String,
    shape: Arc<dyn ObjectShape>,
    first_draw: usize,
    draws: usize,
    first_material: u32,
    /// Its materials can have other colours: it has a bake of its own, which follows.
    is_baked: bool,
}

/// A mesh of an object where it stands.
pub(crate) type PosedDraw = (usize, LoadedDraw);

impl LoadedScene {
    /// Puts an object beside the bake, at rest at the origin. Errs where its meshes contradict themselves or its materials, and changes
    /// nothing then.
    pub fn add_object(&mut self, object: Object) -> Result<()> {
        let Object { name, materials, textures, shape } = object;
        if self.objects.len() >= OBJECTS_MAX {
            return Err(refused(
                &name,
                format!("is one too many: a scene has at most {OBJECTS_MAX} objects"),
            ));
        }
        let [first_texture, first_material] =
            [self.textures.len(), self.manifest.materials.len()].map(|count| count as u32);
        for material in &materials {
            if let Some(bad) = material.textures().find(|used| used.texture as usize >= textures.len()) {
                let problem = format!("names texture {} of {}", bad.texture, textures.len());
                return Err(refused(&name, format!("has a material '{}' that {problem}", material.name)));
            }
        }
        let textures = encoded(&materials, textures)
            .map_err(|index| refused(&name, format!("has a texture {index} that {READ_TWICE}")))?;
        let mut placed = PlacedObject {
            name,
            shape,
            first_draw: self.draws.draws.len(),
            draws: 0,
            first_material,
            is_baked: false,
        };
        let rest = Stance::default();
        let draws = placed.draws_at(&rest, materials.len())?;
        if draws.is_empty() {
            return Err(refused(&placed.name, "has no triangles".to_owned()));
        }
        placed.draws = draws.len();
        self.draws.draws.extend(draws);
        self.manifest
            .materials
            .extend(materials.into_iter().map(|material| shifted(material, first_texture)));
        self.textures.extend(textures.into_iter().map(Arc::new));
        self.objects.push(placed);
        Ok(())
    }

    /// Its own meshes as an object beside another bake.
    pub(crate) fn as_object(&self, name: &str) -> Object {
        let own = &self.draws.draws[..self.own_draws()];
        Object {
            name: name.to_owned(),
            materials: self.own_materials().to_vec(),
            textures: self.textures.iter().map(|texture| (**texture).clone()).collect(),
            shape: Arc::new(Rigid(own.iter().map(unloaded).collect())),
        }
    }

    /// Number of its own meshes: those of objects come behind them.
    pub(crate) fn own_draws(&self) -> usize {
        self.objects.first().map_or(self.draws.draws.len(), |object| object.first_draw)
    }

    /// Names of objects, in their order.
    pub fn object_names(&self) -> impl Iterator<Item = &str> {
        self.objects.iter().map(|object| object.name.as_str())
    }

    /// Length of an object's animation in seconds; 0 where there is none.
    pub fn object_length_s(&self, index: usize, clip: u32) -> f32 {
        self.objects.get(index).map_or(0.0, |object| object.shape.length_s(clip))
    }

    /// Materials of the bake itself: those of objects come behind them.
    pub fn own_materials(&self) -> &[Material] {
        let own = self
            .objects
            .first()
            .map_or(self.manifest.materials.len(), |object| object.first_material as usize);
        &self.manifest.materials[..own]
    }

    /// Materials that can have other colours, with their numbers: those of the bake itself, and of objects with bakes of their own.
    pub fn coloured_materials(&self) -> impl Iterator<Item = (u32, &Material)> + Clone {
        let is_coloured = |(number, _): &(u32, &Material)| {
            let of_object = self.objects.iter().rev().find(|object| object.first_material <= *number);
            of_object.is_none_or(|object| object.is_baked)
        };
        (0..).zip(&self.manifest.materials).filter(is_coloured)
    }

    /// Lets the last object's materials have other colours.
    pub(crate) fn colour_last_object(&mut self) {
        if let Some(object) = self.objects.last_mut() {
            object.is_baked = true;
        }
    }

    /// Number of objects.
    pub fn objects(&self) -> usize {
        self.objects.len()
    }

    /// Meshes of all objects, each with its number, where stances have them; objects without one are at rest.
    pub(crate) fn posed(&self, stances: &[Stance]) -> Result<Vec<PosedDraw>> {
        check_stances(self, stances)?;
        let rest = Stance::default();
        let stance = |index: usize| stances.get(index).unwrap_or(&rest);
        let all = (0..self.objects.len()).map(|index| self.posed_object(index, stance(index)));
        Ok(all.collect::<Result<Vec<_>>>()?.concat())
    }

    /// Meshes of one object where a stance has it, each with its number.
    pub(crate) fn posed_object(&self, index: usize, stance: &Stance) -> Result<Vec<PosedDraw>> {
        let object = &self.objects[index];
        let materials = self.manifest.materials.len() - object.first_material as usize;
        let draws = object.draws_at(stance, materials)?;
        let old = &self.draws.draws[object.first_draw..object.first_draw + object.draws];
        let size = |draw: &LoadedDraw| (draw.material, draw.vertices.len(), draw.triangles.len());
        if !old.iter().map(size).eq(draws.iter().map(size)) {
            let problem = format!("has other meshes at {} s than at rest", stance.time_s);
            return Err(refused(&object.name, problem));
        }
        let numbers = object.first_draw..;
        Ok(numbers.zip(draws).collect())
    }

    /// The same scene with its objects elsewhere.
    pub(crate) fn with_posed(&self, posed: Vec<PosedDraw>) -> Self {
        let mut scene = self.clone();
        for (index, mesh) in posed {
            scene.draws.draws[index] = mesh;
        }
        scene
    }

    /// Bounds of the scene in metres, with objects that have these bounds. A side moves outwards by steps of an eighth of the bake's
    /// diagonal, by a whole one at most: shadow maps of suns stay as they are while an object moves beyond the bake's bounds, and one
    /// that is far away takes no detail from them, though its own shadow.
    pub(crate) fn bounds_with(&self, objects: impl IntoIterator<Item = [Vec3; 2]>) -> [[f32; 3]; 2] {
        let [low, high] = self.manifest.bounds_m.map(Vec3::from);
        let (lowest, highest) = objects
            .into_iter()
            .fold((low, high), |(lowest, highest), [low, high]| (lowest.min(low), highest.max(high)));
        let step = (low.distance(high) / BOUNDS_STEPS).max(f32::MIN_POSITIVE);
        let margin = |beyond: Vec3| (beyond / step).ceil().min(Vec3::splat(BOUNDS_STEPS)) * step;
        [(low - margin(low - lowest)).into(), (high + margin(highest - high)).into()]
    }
}

/// Lower and upper corner of meshes in metres.
pub(crate) fn bounds_of(posed: &[PosedDraw]) -> [Vec3; 2] {
    let places =
        posed.iter().flat_map(|(_, mesh)| &mesh.vertices).map(|vertex| Vec3::from(vertex.position_m));
    places.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)])
}

/// Errs where there are more stances than objects, or one is no place.
pub(crate) fn check_stances(scene: &LoadedScene, stances: &[Stance]) -> Result<()> {
    if stances.len() > scene.objects() {
        let what = format!("{} stances", stances.len());
        let problem = format!("are given for {} objects: give each its object", scene.objects());
        return Err(ClientError::Argument { what, problem });
    }
    let is_place = |stance: &Stance| {
        let Stance { position_m, turn_deg, scale, time_s, swing_deg, hinge_m, .. } = *stance;
        let numbers = [position_m, turn_deg, [scale, time_s, 0.0], swing_deg, hinge_m];
        numbers.as_flattened().iter().all(|number| number.is_finite()) && stance.scale > 0.0
    };
    match stances.iter().position(|stance| !is_place(stance)) {
        Some(index) => {
            let problem = "has a number that is not finite, or no scale above 0".to_owned();
            Err(ClientError::Argument { what: format!("stance {}", index + 1), problem })
        }
        None => Ok(()),
    }
}

/// Place of an object: `T · R_y(yaw) · R_x(pitch) · R_z(roll) · s · H`, H its swing about its hinge.
pub fn world_from_object(stance: &Stance) -> Affine3A {
    let turn = |degrees: [f32; 3]| {
        let [yaw, pitch, roll] = degrees.map(f32::to_radians);
        Quat::from_euler(EulerRot::YXZ, yaw, pitch, roll)
    };
    let (scale, at_m) = (Vec3::splat(stance.scale), Vec3::from(stance.position_m));
    let place = Affine3A::from_scale_rotation_translation(scale, turn(stance.turn_deg), at_m);
    if stance.swing_deg == [0.0; 3] {
        return place;
    }
    let (swing, hinge_m) = (turn(stance.swing_deg), Vec3::from(stance.hinge_m));
    place * Affine3A::from_rotation_translation(swing, hinge_m - swing * hinge_m)
}

/// The turn of a place of uniform scale.
pub(crate) fn turn_of(place: &Affine3A) -> Mat3 {
    let turned = Mat3::from(place.matrix3);
    turned * turned.x_axis.length().max(f32::MIN_POSITIVE).recip()
}

impl PlacedObject {
    /// Its meshes where a stance has them.
    fn draws_at(&self, stance: &Stance, materials: usize) -> Result<Vec<LoadedDraw>> {
        let found = self.shape.draws(stance.clip, stance.time_s);
        let draws = found.map_err(|source| ClientError::Object { name: self.name.clone(), source })?;
        let place = world_from_object(stance);
        let rotation = turn_of(&place);
        let mut posed = Vec::with_capacity(draws.len());
        for draw in draws {
            let mut draw = Draw { front: None, back: None, ..draw };
            let texels = std::mem::take(&mut draw.lightmap_texel);
            let mut mesh = checked(&draw, materials).map_err(|problem| refused(&self.name, problem))?;
            mesh.material += self.first_material;
            // Those of a lightmap of its own.
            for (vertex, texel) in mesh.vertices.iter_mut().zip(texels) {
                vertex.lightmap_texel = texel;
            }
            for Vertex { position_m, normal, .. } in &mut mesh.vertices {
                let at = place.transform_point3((*position_m).into());
                if !at.is_finite() {
                    return Err(refused(
                        &self.name,
                        "stands where numbers end: its place or scale is too large".to_owned(),
                    ));
                }
                *position_m = at.into();
                *normal = (rotation * Vec3::from(*normal)).into();
            }
            posed.push(LoadedDraw { front: NO_BLOCK, back: NO_BLOCK, ..mesh });
        }
        Ok(posed)
    }
}

/// A mesh as chunks have it, without its places in a lightmap's blocks.
fn unloaded(mesh: &LoadedDraw) -> Draw {
    let of = |vertex: &Vertex| (vertex.position_m, vertex.normal);
    let (position_m, normal) = mesh.vertices.iter().map(of).unzip();
    Draw {
        material: mesh.material,
        position_m,
        normal,
        uv: mesh.vertices.iter().map(|vertex| vertex.uv).collect(),
        colour: mesh.vertices.iter().map(|vertex| vertex.colour).collect(),
        lightmap_texel: mesh.vertices.iter().map(|vertex| vertex.lightmap_texel).collect(),
        triangles: mesh.triangles.clone(),
        front: None,
        back: None,
    }
}

fn refused(name: &str, problem: String) -> ClientError {
    ClientError::Argument { what: format!("object '{name}'"), problem }
}

/// A material whose textures come `first` later, and which is no emitter of the bake's.
fn shifted(mut material: Material, first: u32) -> Material {
    material.textures_mut().for_each(|used| used.texture += first);
    Material { emitter: None, ..material }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::manifest::TextureUse;

    use super::*;
    use crate::fixture;

    /// A quad in the xy plane with a corner at the origin, that faces +z.
    fn quad(side_m: f32) -> Draw {
        let corners = [[0.0, 0.0, 0.0], [side_m, 0.0, 0.0], [side_m, side_m, 0.0], [0.0, side_m, 0.0]];
        Draw {
            position_m: corners.to_vec(),
            normal: vec![[0.0, 0.0, 1.0]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Draw::default()
        }
    }

    fn object(draws: Vec<Draw>, material: &Material) -> Object {
        let materials = vec![Material { base_colour_texture: None, ..material.clone() }];
        Object { name: "quad".to_owned(), materials, textures: Vec::new(), shape: Arc::new(Rigid(draws)) }
    }

    fn scene() -> LoadedScene {
        fixture::prt_light(&fixture::prt_contents()).0
    }

    #[test]
    fn stances_scale_then_turn_then_move() {
        let mut scene = scene();
        let material = scene.manifest.materials[0].clone();
        scene.add_object(object(vec![quad(1.0)], &material)).unwrap();
        let stance = Stance {
            position_m: [5.0, 6.0, 7.0],
            turn_deg: [90.0, 0.0, 0.0],
            scale: 2.0,
            ..Stance::default()
        };
        let posed = scene.posed(&[stance]).unwrap();
        let [(index, mesh)] = &posed[..] else { panic!("{}", posed.len()) };
        assert_eq!(*index + 1, scene.draws.draws.len());
        let near = |a: [f32; 3], b: [f32; 3]| Vec3::from(a).distance(b.into()) < 1e-5;
        // A quarter turn about y takes x to −z and z to x.
        assert!(near(mesh.vertices[2].position_m, [5.0, 8.0, 5.0]), "{:?}", mesh.vertices[2]);
        assert!(near(mesh.vertices[2].normal, [1.0, 0.0, 0.0]), "{:?}", mesh.vertices[2]);
        // A swing leaves the hinge, here its corner 2, where it was.
        let door = Stance { swing_deg: [70.0, 10.0, 0.0], hinge_m: [1.0, 1.0, 0.0], ..stance };
        let [(_, closed)] = &scene.posed(&[stance]).unwrap()[..] else { panic!() };
        let [(_, open)] = &scene.posed(&[door]).unwrap()[..] else { panic!() };
        let of = |mesh: &LoadedDraw, corner: usize| mesh.vertices[corner].position_m;
        let hinge = closed.vertices.iter().position(|vertex| near(vertex.position_m, of(mesh, 2))).unwrap();
        assert!(near(of(open, hinge), of(closed, hinge)), "{:?}", of(open, hinge));
        let side = |mesh: &LoadedDraw| Vec3::from(of(mesh, 0)).distance(of(mesh, 2).into());
        assert!((side(open) - side(closed)).abs() < 1e-4 && !near(of(open, 0), of(closed, 0)));
        let bounds = scene.bounds_with([bounds_of(&posed)]);
        assert!(bounds[1][1] >= 8.0 && bounds[0] == scene.manifest.bounds_m[0], "{bounds:?}");
        // Far away it moves them by the diagonal, and by no more.
        let far = scene.bounds_with([[Vec3::splat(1e5); 2]]);
        let [low, high] = scene.manifest.bounds_m.map(Vec3::from);
        assert!((Vec3::from(far[1]) - high - low.distance(high)).abs().max_element() < 1e-3, "{far:?}");
        assert_eq!(scene.bounds_with([[low, high]]), scene.manifest.bounds_m);
        let huge = Stance { position_m: [3e38; 3], scale: 3e38, ..Stance::default() };
        assert!(scene.posed(&[huge]).unwrap_err().to_string().contains("too large"));
        // The scene itself is as it was, and has them in the copy alone.
        assert!(near(scene.draws.draws[*index].vertices[2].position_m, [1.0, 1.0, 0.0]));
        assert_eq!(&scene.with_posed(posed.clone()).draws.draws[*index], mesh);
    }

    #[test]
    fn materials_and_textures_are_numbered_behind_those_of_the_bake() {
        let mut scene = scene();
        let (materials, textures) = (scene.manifest.materials.len(), scene.textures.len());
        let used =
            TextureUse { texture: 0, wrap: [lightkiln_proto::manifest::Wrap::Clamp; 2], transform: None };
        let mut chair = object(vec![quad(1.0)], &scene.manifest.materials[0].clone());
        chair.materials[0].base_colour_texture = Some(used.clone());
        chair.materials[0].emitter = Some(0);
        chair.textures = vec![Texture::new(1, 1, vec![[9; 4]])];
        scene.add_object(chair.clone()).unwrap();
        scene.add_object(chair.clone()).unwrap();
        assert_eq!(scene.draws.draws.last().unwrap().material as usize, materials + 1);
        let last = scene.manifest.materials.last().unwrap();
        assert_eq!(last.base_colour_texture.as_ref().unwrap().texture as usize, textures + 1);
        assert_eq!(last.emitter, None);
        assert_eq!((scene.own_materials().len(), scene.object_names().count()), (materials, 2));
        // A colour of the bake's material is none of the object's, though both have one name.
        let name = scene.manifest.materials[0].name.clone();
        let colours = [super::super::Recolour { material: name, base_colour: [0.1, 0.2, 0.3] }];
        let tints = super::super::Tints::of(&scene, &colours).unwrap();
        assert_eq!(tints.base_colour(&scene, 0)[..3], [0.1, 0.2, 0.3]);
        assert_eq!(
            tints.base_colour(&scene, materials as u32),
            scene.manifest.materials[materials].base_colour
        );
        chair.textures.clear();
        let error = scene.add_object(chair).unwrap_err().to_string();
        assert!(error.contains("texture 0 of 0") && scene.objects() == 2, "{error}");
    }

    #[test]
    fn meshes_that_contradict_themselves_are_refused_and_nothing_changes() {
        let mut scene = scene();
        let material = scene.manifest.materials[0].clone();
        let draws = scene.draws.draws.len();
        let wrong = |change: &dyn Fn(&mut Draw)| {
            let mut draw = quad(1.0);
            change(&mut draw);
            object(vec![draw], &material)
        };
        for (object, word) in [
            (object(Vec::new(), &material), "no triangles"),
            (wrong(&|draw| draw.triangles[0][1] = 4), "vertex above 4"),
            (wrong(&|draw| draw.position_m[0][0] = f32::NAN), "not finite"),
            (wrong(&|draw| draw.material = 1), "material 1 of 1"),
            (wrong(&|draw| draw.uv = vec![[0.0; 2]]), "differ in length"),
        ] {
            let error = scene.add_object(object).unwrap_err().to_string();
            assert!(error.contains("'quad'") && error.contains(word), "{error}");
        }
        assert_eq!((scene.draws.draws.len(), scene.objects()), (draws, 0));
        let stance = Stance::default();
        assert!(scene.posed(&[stance]).unwrap_err().to_string().contains("0 objects"));
    }

    #[test]
    fn shapes_that_grow_with_time_are_refused() {
        #[derive(Debug)]
        struct Growing;
        impl ObjectShape for Growing {
            fn draws(
                &self,
                _: u32,
                time_s: f32,
            ) -> std::result::Result<Vec<Draw>, Box<dyn Error + Send + Sync>> {
                if time_s > 8.0 {
                    return Err("it is gone".into());
                }
                Ok(vec![quad(1.0); 1 + time_s as usize])
            }
        }
        let mut scene = scene();
        let object = object(Vec::new(), &scene.manifest.materials[0].clone());
        scene.add_object(Object { shape: Arc::new(Growing), ..object }).unwrap();
        let at = |time_s| scene.posed(&[Stance { time_s, ..Stance::default() }]);
        assert!(at(0.5).is_ok());
        assert!(at(1.0).unwrap_err().to_string().contains("other meshes at 1 s"));
        let error = at(9.0).unwrap_err();
        assert!(error.to_string().contains("'quad'"), "{error}");
        assert!(error.source().is_some_and(|source| source.to_string().contains("gone")));
        let wrong = scene.posed(&[Stance { scale: 0.0, ..Stance::default() }]).unwrap_err().to_string();
        assert!(wrong.contains("stance 1"), "{wrong}");
    }
}
