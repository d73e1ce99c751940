//! Sights of objects past a bake's own surfaces, on the adapter: cubes like those of lamps, tile by tile in layers behind the lamps' own.

use std::ops::Range;

use super::gpu::ShadowPass;
use super::{Face, Light, ShadowPlan, cleared_depth};
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::stopwatch::Recorder;

/// Texels along a face of the cube at an object's middle. More → sharper ends of its effect at edges of walls.
pub const SIGHT_SIDE: u32 = 64;
/// Faces of a cube.
pub(super) const SIGHT_FACES: u32 = 6;
/// The shape of a light that stands for what an object sees; twin of `SIGHT` in the shaders.
const SIGHT: u32 = 4;

/// Places of what objects see among lights and maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SightPlaces {
    /// First of the lights that stand for it.
    pub first_light: u32,
    /// First of their faces.
    pub first_face: u32,
    /// First layer of these.
    pub first_layer: u32,
}

impl ShadowPass {
    /// Places of what objects see.
    pub fn sight_places(&self) -> SightPlaces {
        self.sights
    }

    /// Writes what objects see, each by a plan of one cube of [`SIGHT_SIDE`].
    pub fn set_sights<'a>(&self, gpu: &Gpu, plans: impl Iterator<Item = &'a ShadowPlan>) {
        let SightPlaces { first_light, first_face, .. } = self.sights;
        for (plan, index) in plans.zip(0_u32..) {
            let face = first_face + SIGHT_FACES * index;
            let light = Light { shape: SIGHT, strength: [0.0; 3], first_face: face, ..plan.lights[0] };
            let at = u64::from(first_light + index) * size_of::<Light>() as u64;
            gpu.queue.write_buffer(&self.rows.lights, at, bytemuck::bytes_of(&light));
            let at = u64::from(face) * size_of::<Face>() as u64;
            gpu.queue.write_buffer(&self.rows.faces, at, bytemuck::cast_slice(&plan.faces));
            for (own, face) in plan.faces.iter().zip(face..) {
                let at = u64::from(face) * u64::from(self.face_stride);
                gpu.queue.write_buffer(&self.projections, at, bytemuck::bytes_of(&own.clip_from_world));
            }
        }
    }

    /// Records what so many objects see of some meshes; glass hides nothing.
    pub fn record_sights(
        &self,
        encoder: &mut Recorder<'_>,
        (meshes, own): (&Meshes, Range<usize>),
        sights: usize,
    ) {
        let along = self.side / SIGHT_SIDE;
        let tiles = (along * along) as usize;
        for layer in 0..(SIGHT_FACES as usize * sights).div_ceil(tiles) {
            let view = &self.face_views[self.sights.first_layer as usize + layer];
            let mark = encoder.mark("shadow");
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("sights of objects"),
                depth_stencil_attachment: Some(cleared_depth(view)),
                timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
                ..Default::default()
            });
            let last = (SIGHT_FACES as usize * sights).min((layer + 1) * tiles);
            for tile in layer * tiles..last {
                let within = (tile % tiles) as u32;
                let [x, y] = [within % along, within / along].map(|at| at * SIGHT_SIDE);
                let side = SIGHT_SIDE as f32;
                pass.set_viewport(x as f32, y as f32, side, side, 0.0, 1.0);
                pass.set_scissor_rect(x, y, SIGHT_SIDE, SIGHT_SIDE);
                let offset = (self.sights.first_face + tile as u32) * self.face_stride;
                self.draw_opaque(&mut pass, (meshes, own.clone()), offset);
            }
        }
    }
}
