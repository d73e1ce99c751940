//! State that the user changes: lights, emitters, colours, exposure, overlay, level of detail.

use std::sync::Arc;

use lightkiln_proto::rectangle::RECT_POINTS;
use lightkiln_proto::relight::Lod;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};
use lightkiln_proto::words::{camera_to_text, light_to_text, lod_to_text, panorama_to_text, stance_to_text};

use crate::bake::Overlay;
use crate::lights::{Panorama, quoted};
use crate::passes::fog::Fog;
use crate::passes::shade::SurfaceDetails;
use crate::picture::{Exposure, Tone};
use crate::preview::View;
use crate::scene::{LoadedScene, Recolour, Stance};

/// Side of a new rectangle as a share of the scene's diagonal.
const RECT_SHARE: f32 = 0.1;

/// Everything that can be changed but for the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Edits {
    /// Lights and skies.
    pub lights: Vec<SceneLight>,
    /// A panorama as a sky.
    pub panorama: Option<Arc<Panorama>>,
    /// Strengths of emitters relative to the bake, one each.
    pub emitters: Vec<f32>,
    /// Colours of materials, by name.
    pub colours: Vec<Colour>,
    /// Objects beside the bake.
    pub objects: Vec<PlacedObject>,
    /// A medium between surfaces.
    pub fog: Option<Fog>,
    /// Details of surfaces that transport does not know.
    pub details: SurfaceDetails,
    /// Exposure.
    pub exposure: Exposure,
    /// Curve.
    pub tone: Tone,
    /// Colours over surfaces.
    pub overlay: Option<Overlay>,
    /// Levels of detail; all of it without.
    pub lod: Option<Lod>,
}

/// An object beside the bake, and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedObject {
    /// Its file.
    pub name: String,
    /// Where it stands.
    pub stance: Stance,
    /// Its animation goes on with time, over and over.
    pub plays: bool,
    /// Length of the animation in seconds; 0 where there is none.
    pub length_s: f32,
}

/// Colour of the materials of a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Colour {
    /// The name.
    pub material: String,
    /// Linear base colour in the bake.
    pub baked: [f32; 3],
    /// Linear base colour.
    pub now: [f32; 3],
    /// It was given, be it that of the bake: other materials of this name may have another there.
    pub is_given: bool,
    /// Of glass, whose colour stays.
    pub is_glass: bool,
}

impl Edits {
    /// The state of a view of a scene, with other colours of materials.
    pub fn of(view: &View, scene: &LoadedScene, recolours: &[Recolour]) -> Self {
        let mut colours: Vec<Colour> = Vec::new();
        for (_, material) in scene.coloured_materials() {
            let [r, g, b, _] = material.base_colour;
            match colours.iter_mut().find(|known| known.material == material.name) {
                Some(known) => known.is_glass |= material.glass.is_some(),
                None => {
                    let recolour = recolours.iter().rev().find(|recolour| recolour.material == material.name);
                    colours.push(Colour {
                        material: material.name.clone(),
                        baked: [r, g, b],
                        now: recolour.map_or([r, g, b], |recolour| recolour.base_colour),
                        is_given: recolour.is_some(),
                        is_glass: material.glass.is_some(),
                    });
                }
            }
        }
        let mut emitters = view.emitter_scale.clone();
        emitters.resize(scene.manifest.emitters.len(), 1.0);
        let stances = view.objects.iter().copied().chain(std::iter::repeat(Stance::default()));
        let names = scene.object_names().enumerate().zip(stances);
        let objects = names.map(|((index, name), stance)| PlacedObject {
            name: name.to_owned(),
            stance,
            plays: false,
            length_s: scene.object_length_s(index, stance.clip),
        });
        let objects = objects.collect();
        Self {
            lights: view.lights.clone(),
            panorama: view.panorama.clone(),
            emitters,
            colours,
            objects,
            fog: view.fog,
            details: view.details,
            exposure: view.exposure,
            tone: view.tone,
            overlay: None,
            lod: view.lod,
        }
    }

    /// Where objects stand.
    pub fn stances(&self) -> Vec<Stance> {
        self.objects.iter().map(|object| object.stance).collect()
    }

    /// Animations that play go on, and begin anew at their ends.
    pub fn play(&mut self, seconds: f32) {
        for PlacedObject { stance, length_s, .. } in self.objects.iter_mut().filter(|object| object.plays) {
            let length_s = length_s.max(f32::MIN_POSITIVE);
            stance.time_s = (stance.time_s + seconds).rem_euclid(length_s).min(length_s);
        }
    }

    /// Colours that are not the bake's.
    pub fn recolours(&self) -> Vec<Recolour> {
        let changed = self.colours.iter().filter(|colour| colour.is_given || colour.now != colour.baked);
        changed
            .map(|colour| Recolour { material: colour.material.clone(), base_colour: colour.now })
            .collect()
    }

    /// The command that draws the same picture, and notes on what its words cannot say.
    pub fn command(&self, bake_words: &str, camera: &SceneCamera, size: [u32; 2]) -> (String, Vec<String>) {
        let mut notes = Vec::new();
        let [width, height] = size;
        let mut words = format!("kiln preview {bake_words} --out picture.png --size {width}x{height}");
        let mut option = |name: &str, value: &str| {
            words.push_str(&format!(" --{name} {}", quoted(value)));
        };
        if camera.orthographic_half_height_m.is_some() {
            notes.push(
                "the camera is a parallel one, for which there are no words: it is left out".to_owned(),
            );
        } else {
            option("camera", &camera_to_text(camera));
        }
        for light in &self.lights {
            option("light", &light_to_text(light));
            if let LightKind::Point { range_m: Some(_), .. } | LightKind::Spot { range_m: Some(_), .. } =
                light.kind
            {
                notes
                    .push(format!("'{}' is cut off at a distance, for which there are no words", light.name));
            }
        }
        if let Some(panorama) = &self.panorama {
            let numbers = [panorama.turn_deg(), panorama.strength()];
            option("sky", &panorama_to_text(panorama.image().name(), numbers));
        }
        match self.emitters.first() {
            Some(first) if self.emitters.iter().any(|scale| scale != first) => {
                notes.push(
                    "emitters differ in strength, for which there are no words: they are left out".to_owned(),
                );
                if self.lights.is_empty() {
                    option("light", "emitters scale=1");
                }
            }
            // Without any light the words would mean the bake's own.
            Some(scale) if *scale != 1.0 || self.lights.is_empty() => {
                option("light", &format!("emitters scale={scale}"));
            }
            None if self.lights.is_empty() => option("light", "emitters scale=0"),
            _ => {}
        }
        for Recolour { material, base_colour: [r, g, b] } in self.recolours() {
            option("material", &format!("{material}={r},{g},{b}"));
        }
        for PlacedObject { name, stance, .. } in &self.objects {
            option("object", format!("{name} {}", stance_to_text(stance)).trim_end());
        }
        if let Some(fog) = self.fog {
            option("fog", &fog.to_string());
        }
        if !self.details.normal_maps {
            option("normal-maps", "off");
        }
        if !self.details.specular {
            option("specular", "off");
        }
        match self.exposure {
            Exposure::Auto { stops: 0.0 } => {}
            Exposure::Auto { stops } => option("exposure", &stops.to_string()),
            Exposure::Fixed(_) => notes.push("a fixed exposure has no words: it is left out".to_owned()),
        }
        match self.tone {
            Tone::Filmic => {}
            Tone::Reinhard => option("tone", "reinhard"),
            Tone::Linear => option("tone", "exposure"),
        }
        if let Some(lod) = &self.lod {
            option("lod", &lod_to_text(lod));
        }
        (words, notes)
    }
}

/// A light of each kind for the panel's buttons, before the eye.
pub fn new_light(kind: &str, number: usize, place_m: [f32; 3], diagonal_m: f32) -> SceneLight {
    let name = format!("{kind} {number}");
    // As bright as a lamp that lights a room of that size.
    let intensity = [0.4 * diagonal_m * diagonal_m; 3];
    let (kind, strength) = match kind {
        "sun" => (LightKind::Sun { direction: [-0.4, -0.8, -0.447_213_6] }, [3.0; 3]),
        "sky" => (LightKind::Sky { zenith: [0.35, 0.5, 0.9], horizon: [0.7, 0.75, 0.8] }, [1.0; 3]),
        "spot" => (
            LightKind::Spot {
                position_m: place_m,
                direction: [0.0, -1.0, 0.0],
                inner_rad: 0.4,
                outer_rad: 0.5,
                range_m: None,
            },
            intensity,
        ),
        "rect" => {
            let side_m = RECT_SHARE * diagonal_m;
            let kind = LightKind::Rect {
                position_m: place_m,
                direction: [0.0, -1.0, 0.0],
                up: [0.0, 0.0, -1.0],
                size_m: [side_m; 2],
                points: RECT_POINTS,
            };
            // Of the same power as a point of that intensity: 4π I = π L A.
            (kind, intensity.map(|channel| 4.0 * channel / (side_m * side_m)))
        }
        _ => (LightKind::Point { position_m: place_m, range_m: None }, intensity),
    };
    SceneLight { name, kind, strength }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::words::lod_from_text;

    use super::*;
    use crate::fixture;
    use crate::lights::{parse_camera, parse_lights};
    use crate::tests::fixture_view;

    #[test]
    fn copied_command_says_the_same_picture_again() {
        let (bake, view) = fixture_view();
        let mut edits = Edits::of(&view, &bake.scene, &[]);
        edits.lights.clear();
        edits
            .lights
            .extend(["point", "spot", "sun", "sky"].map(|kind| new_light(kind, 9, [0.1, 0.2, 0.3], 5.0)));
        edits.emitters = vec![0.25];
        edits.colours[0].now = [0.5, 0.25, 0.125];
        edits.colours[0].material = "it's".to_owned();
        edits.exposure = Exposure::Auto { stops: -1.5 };
        let stance = Stance { position_m: [1.0, 0.0, -2.5], scale: 0.5, ..Stance::default() };
        edits.objects =
            vec![PlacedObject { name: "a chair.glb".to_owned(), stance, plays: false, length_s: 2.0 }];
        edits.lod = Some(lod_from_text("coarse level2=20m,4,8,2,2").unwrap());
        let (command, notes) = edits.command("room.kiln", &view.camera, [640, 360]);
        println!("{command}");
        assert!(notes.is_empty(), "{notes:?}");
        assert!(command.contains(r"--material 'it'\''s=0.5,0.25,0.125' --object"), "{command}");
        assert!(
            command.contains("--object 'a chair.glb pos=1,0,-2.5 scale=0.5' --exposure -1.5"),
            "{command}"
        );
        let quoted: Vec<&str> = command.split('\'').collect();
        let of = |name: &str| -> Vec<&str> {
            let named = |pair: &&[&str]| pair[0].ends_with(&format!("--{name} "));
            quoted.windows(2).filter(named).map(|pair| pair[1]).collect()
        };
        assert_eq!(lod_from_text(of("lod")[0]).ok(), edits.lod);
        let camera = parse_camera(of("camera")[0]).unwrap();
        assert_eq!((camera.eye_m, camera.target_m), (view.camera.eye_m, view.camera.target_m));
        let parsed = parse_lights(&of("light")).unwrap();
        assert_eq!(parsed.emitter_scale, Some(0.25));
        assert_eq!(parsed.lights.len(), edits.lights.len());
        for (read, wanted) in parsed.lights.iter().zip(&edits.lights) {
            assert_eq!(light_to_text(read), light_to_text(wanted));
        }
    }

    #[test]
    fn animations_that_play_begin_anew_at_their_ends() {
        let (bake, view) = fixture_view();
        let mut edits = Edits::of(&view, &bake.scene, &[]);
        let stance = Stance { time_s: 1.5, ..Stance::default() };
        let object = PlacedObject { name: "a.glb".to_owned(), stance, plays: true, length_s: 2.0 };
        edits.objects = vec![object.clone(), PlacedObject { plays: false, ..object }];
        edits.play(1.0);
        assert_eq!(edits.objects.iter().map(|object| object.stance.time_s).collect::<Vec<_>>(), [0.5, 1.5]);
    }

    #[test]
    fn words_that_are_missing_are_said() {
        let (bake, view) = fixture_view();
        let mut edits = Edits::of(&view, &bake.scene, &[]);
        edits.lights.clear();
        edits.emitters = vec![0.5, 1.0];
        edits.exposure = Exposure::Fixed(2.0);
        let camera = SceneCamera { orthographic_half_height_m: Some(1.0), ..view.camera };
        let (command, notes) = edits.command("--server 'http://farm' --bake 12", &camera, [64, 48]);
        assert_eq!(notes.len(), 3, "{notes:?}");
        assert!(!command.contains("--camera"), "{command}");
        assert!(command.contains("--light 'emitters scale=1'"), "the bake's lights stay out: {command}");
    }

    #[test]
    fn colours_are_those_of_the_bake_until_changed() {
        let (scene, _) = fixture::prt_light(&fixture::prt_contents());
        let (_, view) = fixture_view();
        assert!(Edits::of(&view, &scene, &[]).recolours().is_empty());
        let name = scene.manifest.materials[0].name.clone();
        let other = [Recolour { material: name, base_colour: [0.1, 0.2, 0.3] }];
        assert_eq!(Edits::of(&view, &scene, &other).recolours(), other);
    }
}
