//! Sights of objects past a bake's own surfaces, and objects as emitters see them, on the adapter: faces like those of lamps, tile by tile in
//! layers behind the lamps' own.

use std::ops::Range;

use super::gpu::ShadowPass;
use super::{Face, Light, ShadowPlan, cleared_depth};
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::stopwatch::Recorder;

/// Texels along a face of the cube at an object's middle. More → sharper ends of its effect at edges of walls.
pub const SIGHT_SIDE: u32 = 64;
/// Most points of emitters for each object. More → softer edges of shadows of wide emitters, time in proportion.
pub const EMITTER_POINTS: usize = 16;
/// Faces of a cube.
pub(super) const SIGHT_FACES: u32 = 6;
/// Tiles of an object: what it sees, then it as emitters see it.
pub(super) const TILES: u32 = SIGHT_FACES + EMITTER_POINTS as u32;
/// The shape of a light that stands for what an object sees; twin of `SIGHT` in the shaders.
const SIGHT: u32 = 4;

/// Places of what objects see among lights and maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SightPlaces {
    /// First of the lights that stand for it.
    pub first_light: u32,
    /// First of their faces.
    pub first_face: u32,
    /// First face in which an emitter sees an object.
    pub first_silhouette: u32,
    /// First layer of all these.
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
            self.write_faces(gpu, face, &plan.faces);
        }
    }

    /// Writes the faces in which emitters see an object.
    pub fn set_silhouettes(&self, gpu: &Gpu, object: usize, faces: &[Face]) {
        let first = self.sights.first_silhouette + (object * EMITTER_POINTS) as u32;
        self.write_faces(gpu, first, &faces[..faces.len().min(EMITTER_POINTS)]);
    }

    fn write_faces(&self, gpu: &Gpu, first: u32, faces: &[Face]) {
        let at = u64::from(first) * size_of::<Face>() as u64;
        gpu.queue.write_buffer(&self.rows.faces, at, bytemuck::cast_slice(faces));
        for (own, face) in faces.iter().zip(first..) {
            let at = u64::from(face) * u64::from(self.face_stride);
            gpu.queue.write_buffer(&self.projections, at, bytemuck::bytes_of(&own.clip_from_world));
        }
    }

    /// Records what objects see of some meshes, and each of them, by its meshes, as so many points of emitters see it; glass hides nothing.
    pub fn record_sights(
        &self,
        encoder: &mut Recorder<'_>,
        (meshes, own): (&Meshes, Range<usize>),
        objects: &[(Range<usize>, usize)],
    ) {
        let sights = (0..SIGHT_FACES as usize * objects.len()).map(|_| own.clone());
        let seen = objects.iter().flat_map(|(drawn, points)| {
            (0..EMITTER_POINTS).map(|point| if point < *points { drawn.clone() } else { 0..0 })
        });
        let drawn: Vec<Range<usize>> = sights.chain(seen).collect();
        let along = self.side / SIGHT_SIDE;
        let tiles = (along * along) as usize;
        for (layer, drawn) in drawn.chunks(tiles).enumerate() {
            let view = &self.face_views[self.sights.first_layer as usize + layer];
            let mark = encoder.mark("shadow");
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("sights of objects"),
                depth_stencil_attachment: Some(cleared_depth(view)),
                timestamp_writes: mark.as_ref().and_then(|mark| mark.writes(true, true)),
                ..Default::default()
            });
            for (within, drawn) in (0..).zip(drawn) {
                let [x, y] = [within % along, within / along].map(|at| at * SIGHT_SIDE);
                let side = SIGHT_SIDE as f32;
                pass.set_viewport(x as f32, y as f32, side, side, 0.0, 1.0);
                pass.set_scissor_rect(x, y, SIGHT_SIDE, SIGHT_SIDE);
                let tile = (layer * tiles) as u32 + within;
                let offset = (self.sights.first_face + tile) * self.face_stride;
                self.draw_opaque(&mut pass, (meshes, drawn.clone()), offset);
            }
        }
    }
}
