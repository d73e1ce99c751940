//! The medium on the processor; twin of `fog.wgsl` and `over.wgsl`, function by function.

use std::f32::consts::PI;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;

use super::FogNumbers;
use crate::lights::Shape;
use crate::passes::direct::reference::lamp_irradiance;
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{Light, ShadowPlan};

/// Froxels of a view: light scattered towards the eye and optical thickness up to the end of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Froxels {
    numbers: FogNumbers,
    sums: Vec<Vec4>,
}

fn three([x, y, z, _]: [f32; 4]) -> Vec3 {
    Vec3::new(x, y, z)
}

/// Share of light that an optical thickness stops.
fn stopped_by(thickness: f32) -> f32 {
    if thickness < 1e-3 { thickness * (1.0 - 0.5 * thickness) } else { 1.0 - (-thickness).exp() }
}

/// Radiance that a slice of a thick medium would send, from the sums before and behind it.
fn sent(before: Vec4, end: Vec4) -> Vec3 {
    (end - before).truncate() / ((-before.w).exp() * stopped_by(end.w - before.w)).max(1e-30)
}

impl FogNumbers {
    fn depth_of(&self, slices: f32) -> f32 {
        let share = slices / self.size[2] as f32;
        self.picture[2] * share * share
    }

    fn extinction_at(&self, position: Vec3) -> f32 {
        let (above, height_m) = ((position.y - self.eye[3]).max(0.0), self.picture[3]);
        self.eye_per_x[3] * if height_m > 0.0 { (-above / height_m.max(1e-6)).exp() } else { 1.0 }
    }

    /// Henyey and Greenstein's share of scattered light by direction, per steradian.
    pub(super) fn phase(&self, cosine: f32) -> f32 {
        let g = self.ray[3];
        let below = 1.0 + g * g - 2.0 * g * cosine;
        (1.0 - g * g) / (4.0 * PI * below * below.sqrt())
    }

    fn froxel(&self, column: [u32; 2], slice: u32) -> usize {
        ((slice * self.size[1] + column[1]) * self.size[0] + column[0]) as usize
    }
}

impl Froxels {
    /// Of a view, under lights and between probes, whose mean radiance is `mean_radiance`.
    pub fn new(
        numbers: FogNumbers,
        (plan, maps): (&ShadowPlan, &ShadowMaps),
        mean_radiance: &(dyn Fn(Vec3) -> Vec3 + Sync),
    ) -> Self {
        let [columns, rows, slices, side] = numbers.size;
        let scattered = |position: Vec3, ray: Vec3| {
            let of_light = |light: &Light| {
                let away = Vec3::from(light.position) - position;
                let towards = if light.shape == Shape::Sun as u32 {
                    -Vec3::from(light.direction)
                } else {
                    away / away.length_squared().max(1e-30).sqrt()
                };
                let found = lamp_irradiance((plan, maps), light, [position; 2], towards, towards);
                found.truncate() * numbers.phase(towards.dot(ray))
            };
            let sum = mean_radiance(position) + plan.lights.iter().map(of_light).sum::<Vec3>();
            numbers.eye_per_y[3] * sum
        };
        let column = |index: u32| {
            let pixel = (Vec2::new((index % columns) as f32, (index / columns) as f32) + 0.5) * side as f32;
            let picture = Vec2::new(numbers.picture[0], numbers.picture[1]);
            let ndc = Vec2::new(2.0, -2.0) * pixel / picture + Vec2::new(-1.0, 1.0);
            let eye =
                three(numbers.eye) + three(numbers.eye_per_x) * ndc.x + three(numbers.eye_per_y) * ndc.y;
            let along =
                three(numbers.ray) + three(numbers.ray_per_x) * ndc.x + three(numbers.ray_per_y) * ndc.y;
            let per_depth = along.length();
            let mut sum = Vec4::ZERO;
            let slice = |slice: u32| {
                let [start, middle, end] = [0.0, 0.5, 1.0].map(|by| numbers.depth_of(slice as f32 + by));
                let position = eye + along * middle;
                let thickness = numbers.extinction_at(position) * ((end - start) * per_depth);
                let light = scattered(position, along / per_depth) * stopped_by(thickness);
                sum += (light * (-sum.w).exp()).extend(thickness);
                sum
            };
            (0..slices).map(slice).collect::<Vec<_>>()
        };
        let all: Vec<Vec<Vec4>> = (0..columns * rows).into_par_iter().map(column).collect();
        let of_slice = |slice: usize| all.iter().map(move |column| column[slice]);
        Self { sums: (0..slices as usize).flat_map(of_slice).collect(), numbers }
    }

    fn at(&self, column: [u32; 2], slice: u32) -> Vec4 {
        self.sums[self.numbers.froxel(column, slice)]
    }

    /// Light scattered and optical thickness up to a depth in a column.
    fn up_to(&self, column: [u32; 2], slices: f32) -> Vec4 {
        let numbers = &self.numbers;
        let slice = (slices as u32).min(numbers.size[2] - 1);
        let [low, high] = [slice, slice + 1].map(|slice| numbers.depth_of(slice as f32));
        let part = (numbers.depth_of(slices) - low) / (high - low);
        let end = self.at(column, slice);
        let (mut start, mut radiance) = (Vec4::ZERO, sent(Vec4::ZERO, end));
        if slice > 0 {
            start = self.at(column, slice - 1);
            let before = if slice > 1 { self.at(column, slice - 2) } else { Vec4::ZERO };
            radiance = sent(before, start).lerp(sent(start, end), (2.0 * part - 1.0).clamp(0.0, 1.0));
        }
        let thickness = (end.w - start.w) * part;
        let more = radiance * ((-start.w).exp() * stopped_by(thickness));
        (start.truncate() + more).extend(start.w + thickness)
    }

    /// A pixel's radiance behind the medium; its alpha stays. `z` is its depth in the picture.
    pub fn over(&self, radiance: Vec4, [x, y]: [f32; 2], z: f32) -> Vec4 {
        let numbers = &self.numbers;
        let [a, b, c, d] = numbers.by_depth;
        let (below, far_m) = (z * d - b, numbers.picture[2]);
        let depth = if z <= 0.0 || below == 0.0 { far_m } else { (a - z * c) / below };
        let slices = numbers.size[2] as f32 * (depth / far_m).clamp(0.0, 1.0).sqrt();
        let last = [numbers.size[0] - 1, numbers.size[1] - 1];
        let columns = Vec2::new(x, y) / numbers.size[3] as f32 - 0.5;
        let columns = columns.clamp(Vec2::ZERO, Vec2::new(last[0] as f32, last[1] as f32));
        let first = [columns.x as u32, columns.y as u32];
        let next = [(first[0] + 1).min(last[0]), (first[1] + 1).min(last[1])];
        let share = columns - Vec2::new(first[0] as f32, first[1] as f32);
        let upper = self.up_to(first, slices).lerp(self.up_to([next[0], first[1]], slices), share.x);
        let lower = self.up_to([first[0], next[1]], slices).lerp(self.up_to(next, slices), share.x);
        let found = upper.lerp(lower, share.y);
        (found.truncate() + radiance.truncate() * (-found.w).exp()).extend(radiance.w)
    }
}
