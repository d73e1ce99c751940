//! Which probes support a place, and how much: `w_p(x)` (METHOD.md §2).

use glam::Vec3;
use lightkiln_proto::kinds::sh::Probe;

use super::probes::kernel;

/// A probe within reach of a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supporter {
    /// Index into the probes given.
    pub probe: u32,
    /// p in metres.
    pub position_m: Vec3,
    /// `w_p(x) = 2t³ − 3t² + 1`, t = ‖x − p‖ / radius_p; above 0.
    pub weight: f32,
}

/// Probes to look among.
#[derive(Clone, Debug)]
pub struct Supporters {
    probes: Vec<(u32, Vec3, f32)>,
}

impl Supporters {
    /// All of `probes`.
    pub fn new(probes: &[Probe]) -> Self {
        Self::where_(probes, |_, _| true)
    }

    /// Those that reach into a box.
    pub fn reaching(probes: &[Probe], low_m: Vec3, high_m: Vec3) -> Self {
        Self::where_(probes, |position_m, radius_m| {
            position_m.distance(position_m.clamp(low_m, high_m)) < radius_m
        })
    }

    fn where_(probes: &[Probe], keep: impl Fn(Vec3, f32) -> bool) -> Self {
        let all =
            probes.iter().enumerate().map(|(i, p)| (i as u32, Vec3::from_array(p.position_m), p.radius_m));
        Self { probes: all.filter(|&(_, position_m, radius_m)| keep(position_m, radius_m)).collect() }
    }

    /// Indices of the probes, ascending.
    pub fn indices(&self) -> impl Iterator<Item = u32> + '_ {
        self.probes.iter().map(|(index, _, _)| *index)
    }

    /// Supporters of a point, by ascending index; `probe` counts among those of [`Supporters::indices`]' source.
    pub fn around(&self, point_m: Vec3) -> Vec<Supporter> {
        self.probes
            .iter()
            .filter_map(|&(probe, position_m, radius_m)| {
                let weight = kernel(point_m.distance(position_m) / radius_m);
                (weight > 0.0).then_some(Supporter { probe, position_m, weight })
            })
            .collect()
    }
}
