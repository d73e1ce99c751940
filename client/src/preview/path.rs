//! A path of camera, lights and objects: keys at numbered pictures, and the views between them.

use glam::Vec3;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight, Stance};
use lightkiln_proto::words::stance_from_text;
use serde::Deserialize;

use super::View;
use crate::error::{ClientError, Result};
use crate::lights::{ParsedLights, parse_camera, parse_lights};

/// Most pictures of a path: files are numbered with four digits.
const PICTURES_MAX: u32 = 9_999;
/// Most lights of a key, skies among them.
const LIGHTS_MAX: usize = 256;
/// Most bytes of a path's file.
pub const FILE_MAX: u64 = 1 << 20;

/// Keys with ascending numbers; the first is number 1.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewPath(Vec<Key>);

/// Where camera, lights and objects are in a picture.
#[derive(Clone, Debug, PartialEq)]
struct Key {
    picture: u32,
    camera: Option<SceneCamera>,
    lights: Option<ParsedLights>,
    objects: Option<Vec<Stance>>,
}

/// A file of keys.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    keys: Vec<Words>,
}

/// A key as people write it: words of the command line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Words {
    picture: u32,
    camera: Option<String>,
    lights: Option<Vec<String>>,
    objects: Option<Vec<String>>,
}

fn wrong(what: impl Into<String>, problem: impl Into<String>) -> ClientError {
    ClientError::Argument { what: what.into(), problem: problem.into() }
}

impl ViewPath {
    /// Reads a file's JSON: `{"keys": [{"picture": 1, "camera": "eye=… target=…", "lights": ["point pos=… power=20"],
    /// "objects": ["pos=… turn=…"]}, …]}`. Between keys all numbers go evenly but the points of rectangles, which are those of the
    /// key before.
    pub fn parse(json: &[u8]) -> Result<Self> {
        let File { keys } = serde_json::from_slice(json).map_err(|error| {
            wrong(
                "the path",
                format!(
                    "cannot be read ({error}); it is {{\"keys\": [{{\"picture\": 1, \"camera\": …, \"lights\": […]}}, …]}}"
                ),
            )
        })?;
        let key = |Words { picture, camera, lights, objects }: Words| -> Result<Key> {
            let camera = camera.as_deref().map(parse_camera).transpose()?;
            let lights = lights.map(|lights| parse_lights(&lights)).transpose()?;
            let stance = |words: &String| {
                stance_from_text(words).map_err(|error| wrong(format!("\"{words:.200}\""), error.to_string()))
            };
            let objects = objects.map(|objects| objects.iter().map(stance).collect()).transpose()?;
            Ok(Key { picture, camera, lights, objects })
        };
        let keys = keys.into_iter().map(key).collect::<Result<Vec<Key>>>()?;
        match keys.first() {
            None => return Err(wrong("the path", "has no keys")),
            Some(first) if first.picture != 1 => {
                return Err(wrong(
                    format!("picture {}", first.picture),
                    "is no first key: pictures count from 1",
                ));
            }
            Some(_) => {}
        }
        if let Some(key) =
            keys.iter().find(|key| key.lights.as_ref().is_some_and(|of| of.lights.len() > LIGHTS_MAX))
        {
            return Err(wrong(
                format!("key of picture {}", key.picture),
                format!("has more than {LIGHTS_MAX} lights"),
            ));
        }
        keys.windows(2).try_for_each(|pair| pair[0].check(&pair[1]))?;
        Ok(Self(keys))
    }

    /// Number of pictures.
    pub fn pictures(&self) -> u32 {
        self.0.last().map_or(0, |key| key.picture)
    }

    /// Camera of the first picture, if keys have any.
    pub fn first_camera(&self) -> Option<&SceneCamera> {
        self.0.first().and_then(|key| key.camera.as_ref())
    }

    /// Lights of the first picture, if keys have any.
    pub fn first_lights(&self) -> Option<&[SceneLight]> {
        self.0.first().and_then(|key| key.lights.as_ref()).map(|lights| &lights.lights[..])
    }

    /// Objects that keys place, if they place any.
    pub fn objects(&self) -> Option<usize> {
        self.0.first().and_then(|key| key.objects.as_ref()).map(Vec::len)
    }

    /// The same path with each key's lights and the factor on emitters as `change` gives them.
    #[must_use]
    pub fn with_lights(mut self, change: impl Fn(ParsedLights) -> ParsedLights) -> Self {
        for key in &mut self.0 {
            key.lights = key.lights.take().map(&change);
        }
        self
    }

    /// The view of a picture, from 1; what keys leave out is that of `base`.
    pub fn view(&self, picture: u32, base: &View) -> View {
        let next = self.0.partition_point(|key| key.picture < picture).min(self.0.len() - 1);
        let (a, b) = (&self.0[next.saturating_sub(1)], &self.0[next]);
        let length = (b.picture - a.picture).max(1);
        let share = if picture < b.picture { (picture - a.picture) as f32 / length as f32 } else { 1.0 };
        let mut view = base.clone();
        if let (Some(a), Some(b)) = (&a.camera, &b.camera) {
            view.camera = camera_between(a, b, share);
        }
        if let (Some(a), Some(b)) = (&a.lights, &b.lights) {
            let pairs = a.lights.iter().zip(&b.lights);
            view.lights = pairs.map(|(a, b)| light_between(a, b, share)).collect();
            if let (Some(a), Some(b)) = (a.emitter_scale, b.emitter_scale) {
                view.emitter_scale.fill(mix(a, b, share));
            }
        }
        if let (Some(a), Some(b)) = (&a.objects, &b.objects) {
            view.objects = a.iter().zip(b).map(|(a, b)| stance_between(a, b, share)).collect();
        }
        view
    }
}

impl Key {
    /// The next key goes on from this one.
    fn check(&self, next: &Self) -> Result<()> {
        let place = format!("key of picture {}", next.picture);
        if next.picture <= self.picture || next.picture > PICTURES_MAX {
            let problem =
                format!("comes after picture {}: numbers ascend, to {PICTURES_MAX} at most", self.picture);
            return Err(wrong(place, problem));
        }
        let has_both = |a: bool, b: bool, what: &str| {
            let problem = format!("either all keys have {what} or none has");
            if a == b { Ok(()) } else { Err(wrong(place.clone(), problem)) }
        };
        has_both(self.camera.is_some(), next.camera.is_some(), "a camera")?;
        has_both(self.lights.is_some(), next.lights.is_some(), "lights")?;
        has_both(self.objects.is_some(), next.objects.is_some(), "'objects'")?;
        let clips = |key: &Self| -> Option<Vec<u32>> {
            Some(key.objects.as_ref()?.iter().map(|stance| stance.clip).collect())
        };
        if clips(self) != clips(next) {
            let problem = "has other objects, or other animations of them, than the key before: give as many, in the same order";
            return Err(wrong(place, problem));
        }
        let (Some(a), Some(b)) = (&self.lights, &next.lights) else { return Ok(()) };
        has_both(a.emitter_scale.is_some(), b.emitter_scale.is_some(), "'emitters'")?;
        let kind = |light: &SceneLight| std::mem::discriminant(&light.kind);
        if a.lights.iter().map(kind).eq(b.lights.iter().map(kind)) {
            return Ok(());
        }
        Err(wrong(place, "has other kinds of lights than the key before: give the same, in the same order"))
    }
}

fn mix(a: f32, b: f32, share: f32) -> f32 {
    // To the bit one or the other at the ends.
    if share >= 1.0 { b } else { a + (b - a) * share }
}

fn mix3(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    [0, 1, 2].map(|axis| mix(a[axis], b[axis], share))
}

/// The direction on the great circle's chord; the first one where two are opposite.
fn turned(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    if share <= 0.0 || share >= 1.0 {
        return if share <= 0.0 { a } else { b };
    }
    Vec3::from(mix3(a, b, share)).try_normalize().map_or(a, Into::into)
}

/// Numbers go evenly: a turn by 720 degrees is two whole ones.
fn stance_between(a: &Stance, b: &Stance, share: f32) -> Stance {
    Stance {
        position_m: mix3(a.position_m, b.position_m, share),
        turn_deg: mix3(a.turn_deg, b.turn_deg, share),
        scale: mix(a.scale, b.scale, share),
        time_s: mix(a.time_s, b.time_s, share),
        clip: a.clip,
        swing_deg: mix3(a.swing_deg, b.swing_deg, share),
        hinge_m: mix3(a.hinge_m, b.hinge_m, share),
    }
}

fn camera_between(a: &SceneCamera, b: &SceneCamera, share: f32) -> SceneCamera {
    let half_heights = a.orthographic_half_height_m.zip(b.orthographic_half_height_m);
    SceneCamera {
        name: a.name.clone(),
        eye_m: mix3(a.eye_m, b.eye_m, share),
        target_m: mix3(a.target_m, b.target_m, share),
        up: turned(a.up, b.up, share),
        fov_y_rad: mix(a.fov_y_rad, b.fov_y_rad, share),
        orthographic_half_height_m: half_heights.map(|(a, b)| mix(a, b, share)),
    }
}

/// Numbers go evenly; points of rectangles, which are whole, are those of the key before until the next is reached.
fn light_between(a: &SceneLight, b: &SceneLight, share: f32) -> SceneLight {
    use LightKind::{Point, Rect, Sky, Spot, Sun};
    let range = |a: Option<f32>, b: Option<f32>| a.zip(b).map(|(a, b)| mix(a, b, share));
    let kind = match (&a.kind, &b.kind) {
        (Point { position_m: p, range_m: r }, Point { position_m: q, range_m: s }) => {
            Point { position_m: mix3(*p, *q, share), range_m: range(*r, *s) }
        }
        (
            Spot { position_m: p, direction: d, inner_rad: i, outer_rad: o, range_m: r },
            Spot { position_m: q, direction: e, inner_rad: j, outer_rad: u, range_m: s },
        ) => Spot {
            position_m: mix3(*p, *q, share),
            direction: turned(*d, *e, share),
            inner_rad: mix(*i, *j, share),
            outer_rad: mix(*o, *u, share),
            range_m: range(*r, *s),
        },
        (Sun { direction: d }, Sun { direction: e }) => Sun { direction: turned(*d, *e, share) },
        (
            Rect { position_m: p, direction: d, up: u, size_m: [w, h], points: n },
            Rect { position_m: q, direction: e, up: v, size_m: [x, i], points: m },
        ) => Rect {
            position_m: mix3(*p, *q, share),
            direction: turned(*d, *e, share),
            up: turned(*u, *v, share),
            size_m: [mix(*w, *x, share), mix(*h, *i, share)],
            points: if share >= 1.0 { *m } else { *n },
        },
        (Sky { zenith: z, horizon: h }, Sky { zenith: y, horizon: g }) => {
            Sky { zenith: mix3(*z, *y, share), horizon: mix3(*h, *g, share) }
        }
        // Keys have the same kinds.
        (other, _) => other.clone(),
    };
    SceneLight { name: a.name.clone(), kind, strength: mix3(a.strength, b.strength, share) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::fixture_view;

    fn parsed(json: &serde_json::Value) -> Result<ViewPath> {
        ViewPath::parse(json.to_string().as_bytes())
    }

    fn all(path: &ViewPath, base: &View) -> Vec<View> {
        (1..=path.pictures()).map(|picture| path.view(picture, base)).collect()
    }

    #[test]
    fn views_go_evenly_from_key_to_key_and_hit_them() {
        let path = parsed(&serde_json::json!({ "keys": [
            { "picture": 1, "camera": "eye=0,1,4 target=0,1,0 fov=50", "lights": ["point pos=0,2,0 power=10", "sun dir=0,-1,0 irradiance=1"] },
            { "picture": 5, "camera": "eye=4,1,0 target=0,1,0 fov=30", "lights": ["point pos=2,2,0 power=20", "sun dir=1,0,0 irradiance=3"] },
            { "picture": 6, "camera": "eye=0,1,0 target=1,1,0 fov=30", "lights": ["point pos=2,2,8 power=20", "sun dir=1,0,0 irradiance=3"] },
        ] }))
        .unwrap();
        let (_, base) = fixture_view();
        let views = all(&path, &base);
        assert_eq!(views.len(), 6);
        assert_eq!(views[2].camera.eye_m, [2.0, 1.0, 2.0]);
        assert_eq!([views[4].camera.eye_m, views[5].camera.eye_m], [[4.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        let point = |view: &View| match view.lights[0].kind {
            LightKind::Point { position_m, .. } => position_m,
            _ => panic!("{:?}", view.lights),
        };
        assert_eq!(
            [1, 4, 5].map(|at| point(&views[at])),
            [[0.5, 2.0, 0.0], [2.0, 2.0, 0.0], [2.0, 2.0, 8.0]]
        );
        let LightKind::Sun { direction } = views[2].lights[1].kind else { panic!("no sun") };
        assert!((Vec3::from(direction) - Vec3::new(0.5, -0.5, 0.0).normalize()).length() < 1e-6);
        assert!((views[2].lights[1].strength[0] - 2.0).abs() < 1e-6);
        // Size, exposure and the like stay.
        assert_eq!(views[3].size(), base.size());
    }

    #[test]
    fn points_of_rectangles_are_those_of_the_key_before() {
        let key = |picture: u32, points: u32| {
            let words = format!("rect pos=0,{picture},0 dir=0,-1,0 size=1,1 radiance=1 points={points}");
            serde_json::json!({ "picture": picture, "lights": [words] })
        };
        let path = parsed(&serde_json::json!({ "keys": [key(1, 4), key(3, 9), key(4, 1)] })).unwrap();
        let (_, base) = fixture_view();
        let points = |view: &View| match view.lights[0].kind {
            LightKind::Rect { points, .. } => points,
            _ => 0,
        };
        assert_eq!(all(&path, &base).iter().map(points).collect::<Vec<_>>(), [4, 4, 9, 1]);
    }

    #[test]
    fn objects_move_turn_and_play_evenly() {
        let path = parsed(&serde_json::json!({ "keys": [
            { "picture": 1, "objects": ["pos=0,0,0 time=1 clip=2", "scale=2"] },
            { "picture": 3, "objects": ["pos=2,0,4 turn=720,0,0 time=3 clip=2", "scale=4"] },
        ] }))
        .unwrap();
        let (_, base) = fixture_view();
        let middle = path.view(2, &base).objects;
        let expected = Stance {
            position_m: [1.0, 0.0, 2.0],
            turn_deg: [360.0, 0.0, 0.0],
            scale: 1.0,
            time_s: 2.0,
            clip: 1,
            ..Stance::default()
        };
        assert_eq!((middle[0], middle[1].scale, path.objects()), (expected, 3.0, Some(2)));
        for (keys, word) in [
            (serde_json::json!([{ "picture": 1, "objects": ["pos=0"] }]), "pos=0"),
            (serde_json::json!([{ "picture": 1, "objects": [""] }, { "picture": 2 }]), "'objects'"),
            (
                serde_json::json!([{ "picture": 1, "objects": [""] }, { "picture": 2, "objects": [] }]),
                "picture 2",
            ),
            (
                serde_json::json!([{ "picture": 1, "objects": [""] }, { "picture": 2, "objects": ["clip=3"] }]),
                "animations",
            ),
        ] {
            let error = parsed(&serde_json::json!({ "keys": keys })).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn what_keys_leave_out_stays_and_one_key_is_one_picture() {
        let (_, base) = fixture_view();
        let lamp = parsed(&serde_json::json!({ "keys": [
            { "picture": 1, "lights": ["emitters scale=0"] }, { "picture": 3, "lights": ["emitters scale=2"] },
        ] }))
        .unwrap();
        let views = all(&lamp, &base);
        assert!(views.iter().all(|view| view.camera == base.camera && view.lights.is_empty()));
        assert_eq!(views.iter().map(|view| view.emitter_scale[0]).collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
        let still = parsed(&serde_json::json!({ "keys": [{ "picture": 1 }] })).unwrap();
        assert_eq!(all(&still, &base), [base]);
    }

    #[test]
    fn keys_that_do_not_go_together_are_errors_that_name_them() {
        let camera = "eye=0,1,4 target=0,1,0 fov=50";
        for (keys, word) in [
            (serde_json::json!([]), "no keys"),
            (serde_json::json!([{ "picture": 2 }]), "count from 1"),
            (serde_json::json!([{ "picture": 1 }, { "picture": 1 }]), "picture 1"),
            (serde_json::json!([{ "picture": 1 }, { "picture": 20_000 }]), "9999"),
            (serde_json::json!([{ "picture": 1, "camera": camera }, { "picture": 9 }]), "a camera"),
            (serde_json::json!([{ "picture": 1, "camera": "eye=0" }]), "eye=0"),
            (serde_json::json!([{ "picture": 1, "lights": vec!["sky"; 300] }]), "256 lights"),
            (
                serde_json::json!([
                    { "picture": 1, "lights": ["sun dir=0,-1,0 irradiance=1"] },
                    { "picture": 9, "lights": ["point pos=0,2,0 power=10"] },
                ]),
                "picture 9",
            ),
        ] {
            let error = parsed(&serde_json::json!({ "keys": keys })).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        let error = ViewPath::parse(b"[1]").unwrap_err().to_string();
        assert!(error.contains("keys"), "{error}");
    }
}
