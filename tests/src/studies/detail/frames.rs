//! How much pictures, and light at receivers, change from frame to frame while a lamp and two objects move.

use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{Vec3, Vec4};
use lightkiln_client::preview::View;
use lightkiln_client::scene::{Object, Rigid, Stance};
use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::Material;
use lightkiln_proto::scene::LightKind;

use super::{Setup, Stage};

/// Frames, each with one bounce.
const FRAMES: usize = 50;
/// Side of the objects over the scene's diagonal.
const SIDE: f32 = 0.04;

/// Changes under a setup.
#[derive(Clone, Debug)]
pub struct Moved {
    /// Name of the setup.
    pub name: String,
    /// Mean absolute change of a pixel's radiance from frame to frame over its mean.
    pub change: f64,
    /// That of the frame that changes most.
    pub change_max: f64,
    /// As `change`, of E_ind at receivers.
    pub indirect: f64,
    /// That of the frame whose E_ind changes most.
    pub indirect_max: f64,
}

/// Changes of some values from frame to frame.
#[derive(Default)]
struct Changes {
    before: Option<Vec<Vec4>>,
    /// Sum of changes by frame.
    sums: Vec<f64>,
    /// Sum of the values of these frames.
    total: f64,
}

impl Changes {
    fn add(&mut self, now: Vec<Vec4>) {
        let size = |value: Vec4| f64::from(value.truncate().abs().element_sum());
        if let Some(before) = &self.before {
            self.sums.push(now.iter().zip(before).map(|(now, before)| size(*now - *before)).sum());
            self.total += now.iter().map(|now| size(*now)).sum::<f64>();
        }
        self.before = Some(now);
    }

    /// The mean over frames, and the largest, both over the values' mean.
    fn over_mean(&self) -> [f64; 2] {
        let largest = self.sums.iter().copied().fold(0.0, f64::max);
        [self.sums.iter().sum::<f64>() / self.total, largest * self.sums.len() as f64 / self.total]
    }
}

/// Plays the frames under each setup: the first lamp goes around its place, two cubes across it.
pub fn moved(stage: &mut Stage, view: &View, setups: &[Setup]) -> Result<Vec<Moved>> {
    if stage.bake.scene.objects() == 0 {
        for name in ["first", "second"] {
            stage.bake.add_object(cube(name))?;
        }
    }
    let all = Setup { name: "all detail".to_owned(), lod: None };
    [&all].into_iter().chain(setups).map(|setup| played(stage, view, setup)).collect()
}

fn played(stage: &Stage, view: &View, setup: &Setup) -> Result<Moved> {
    let mut frame = stage.frame(view)?;
    frame.set_lod(setup.lod)?;
    let (mut pixels, mut receivers) = (Changes::default(), Changes::default());
    for index in 0..FRAMES {
        let share = index as f32 / FRAMES as f32;
        let (lights, stances) = placed(stage, view, share);
        frame.set_lights(&lights)?;
        frame.set_objects(&stances)?;
        if index == 0 {
            frame.settle(super::LIMIT)?;
        }
        frame.advance()?;
        frame.draw([0.0; 2])?;
        pixels.add(frame.read()?);
        receivers.add(frame.read_receivers()?.context("the bake has no receivers")?.indirect);
    }
    let ([change, change_max], [indirect, indirect_max]) = (pixels.over_mean(), receivers.over_mean());
    Ok(Moved { name: setup.name.clone(), change, change_max, indirect, indirect_max })
}

/// Lights and stances at a share of the way.
fn placed(stage: &Stage, view: &View, share: f32) -> (Vec<lightkiln_proto::scene::SceneLight>, Vec<Stance>) {
    let [low, high] = stage.bake.scene.manifest.bounds_m.map(Vec3::from);
    let diagonal_m = low.distance(high);
    let turn = std::f32::consts::TAU * share;
    let mut lights = view.lights.clone();
    let mut middle = 0.5 * (low + high);
    for light in &mut lights {
        if let LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } = &mut light.kind {
            middle = Vec3::from(*position_m);
            *position_m = (middle + 0.05 * diagonal_m * Vec3::new(turn.cos(), 0.0, turn.sin())).into();
            break;
        }
    }
    let stance = |offset: Vec3| Stance {
        position_m: (middle + diagonal_m * offset).into(),
        turn_deg: [360.0 * share, 0.0, 0.0],
        scale: SIDE * diagonal_m,
        ..Stance::default()
    };
    let along = 0.16 * (share - 0.5);
    let stances = vec![stance(Vec3::new(along, -0.05, 0.08)), stance(Vec3::new(-0.08, -0.05, along))];
    (lights, stances)
}

/// A grey cube of side 1 about the origin.
fn cube(name: &str) -> Object {
    let mut draw = Draw::default();
    for axis in 0..3 {
        let unit = |axis: usize| Vec3::AXES[axis % 3];
        for side in [-0.5_f32, 0.5] {
            let (u, v) = (unit(axis + 1), unit(axis + 2) * side.signum());
            let first = draw.position_m.len() as u32;
            for (s, t) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                draw.position_m.push((unit(axis) * side + u * s + v * t).into());
                draw.normal.push((unit(axis) * side.signum()).into());
            }
            draw.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    let material = Material {
        name: name.to_owned(),
        base_colour: [0.5, 0.5, 0.5, 1.0],
        base_colour_texture: None,
        emissive: [0.0; 3],
        emissive_texture: None,
        emitter: None,
        alpha_cutoff: None,
        glass: None,
        normal_map: None,
        specular: None,
        double_sided: false,
    };
    let shape = Arc::new(Rigid(vec![draw]));
    Object { name: name.to_owned(), materials: vec![material], textures: Vec::new(), shape }
}
