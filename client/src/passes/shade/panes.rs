//! Triangles of glass in the order in which they are drawn over what is behind them: the farthest first, by their middles.
//! Panes that cut each other, or are wide beside others, may then come in the wrong order; the light on them stays right.

use std::ops::Range;

use glam::Vec3;

use super::ShadeView;
use crate::scene::{LoadedDraw, LoadedScene};

/// All glass of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panes(Vec<Pane>);

/// A triangle of glass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pane {
    /// Number of the draw.
    pub draw: u32,
    /// Corners among the draw's vertices.
    pub corners: [u32; 3],
    /// Number of the triangle in the draw.
    pub triangle: u32,
    middle_m: Vec3,
}

impl Pane {
    fn of(draw: u32, triangle: u32, mesh: &LoadedDraw) -> Self {
        let corners = mesh.triangles[triangle as usize];
        let at = corners.map(|vertex| Vec3::from(mesh.vertices[vertex as usize].position_m));
        Self { draw, corners, triangle, middle_m: (at[0] + at[1] + at[2]) / 3.0 }
    }
}

impl Panes {
    /// The glass of a scene.
    pub fn of(scene: &LoadedScene) -> Self {
        let meshes = scene.draws.draws.iter().zip(0..).filter(|(mesh, _)| scene.glass_of(mesh).is_some());
        let of_mesh = meshes.flat_map(|(mesh, draw)| {
            (0..mesh.triangles.len() as u32).map(move |triangle| Pane::of(draw, triangle, mesh))
        });
        Self(of_mesh.collect())
    }

    /// Moves the triangles of a mesh that are of glass.
    pub fn set(&mut self, index: u32, mesh: &LoadedDraw) {
        for pane in self.0.iter_mut().filter(|pane| pane.draw == index) {
            *pane = Pane::of(index, pane.triangle, mesh);
        }
    }

    /// How many triangles there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The triangles from the farthest to the nearest, of equally far ones the first of the scene before.
    pub fn farthest_first(&self, view: &ShadeView) -> Vec<Pane> {
        let projection = view.projection();
        // Depth is reversed: it grows towards the eye. A point beside or behind the eye is the nearest.
        let nearness = |pane: &Pane| {
            let clip = projection * pane.middle_m.extend(1.0);
            if clip.w > 0.0 { clip.z / clip.w } else { f32::INFINITY }
        };
        let mut sorted: Vec<(f32, Pane)> = self.0.iter().map(|pane| (nearness(pane), *pane)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        sorted.into_iter().map(|(_, pane)| pane).collect()
    }
}

/// Runs of triangles of one draw, each with its place in the order.
pub fn runs(sorted: &[Pane]) -> Vec<(u32, Range<u32>)> {
    let mut start = 0;
    let same = sorted.chunk_by(|a, b| a.draw == b.draw);
    same.map(|run| {
        let range = start..start + run.len() as u32;
        start = range.end;
        (run[0].draw, range)
    })
    .collect()
}
