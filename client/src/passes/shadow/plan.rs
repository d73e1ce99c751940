//! Shadow maps of a set of lights: six faces around a point, one for a narrow spot, tiles for a sun, half a cube of five faces
//! before each point of a rectangle.

use glam::{Mat4, Vec3};

use crate::error::{ClientError, Result};
use crate::lights::{Caster, Shape};
use crate::raster::{look_along, parallel, perspective};

/// Most texels of all shadow maps together; 4 bytes each, and in a scene with glass 10.
const MAX_TEXELS: u64 = 1 << 26;
/// Most faces: layers of one texture.
const MAX_FACES: usize = 256;
/// Longest side of a face in texels.
pub const MAX_SIDE: u32 = 4096;
/// Shortest.
pub const MIN_SIDE: u32 = 64;
/// Faces along each side of a sun's box. More → sharper sun, more memory.
const SUN_TILES: u32 = 2;
/// Most cascades of a sun.
const CASCADES_MAX: u32 = 3;
/// Factor by which a cascade's texels are finer than those of the next wider one.
const CASCADE_STEP: f32 = 4.0;
/// Side of a shadow texel in metres that is fine enough for any picture; in a scene less than a metre long, as a share of
/// that.
const FINEST_M: f32 = 1e-3;
/// Texels around a face that neighbours share, so that the filter stays inside.
const GUARD_TEXELS: f32 = 4.0;
/// Texels by which depth may lie aside where adapters keep eight bits of a pixel, as all do but some in software: four times the
/// half of a step, as depth is taken from several texels.
const SNAP: f32 = 1.0 / 128.0;
/// Faces before each point of a rectangle: half a cube.
pub const RECT_FACES: u32 = 5;
/// Widest spot that one perspective face covers; wider ones get six.
const SPOT_COS_MIN: f32 = 0.6;

/// A light as the shaders read it; twin of `Light` in `light.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Light {
    /// Metres; for a sun the centre of its box, for a rectangle its own.
    pub position: [f32; 3],
    /// Cut-off distance in metres, 0 for none.
    pub range_m: f32,
    /// Unit direction of travel.
    pub direction: [f32; 3],
    /// [`Shape`] as a number.
    pub shape: u32,
    /// W·sr⁻¹; W·m⁻² for a sun; W·m⁻²·sr⁻¹ for a rectangle.
    pub strength: [f32; 3],
    /// First of its faces.
    pub first_face: u32,
    /// Cosine of a spot's inner half angle.
    pub cone_cos_inner: f32,
    /// Cosine of a spot's outer half angle.
    pub cone_cos_outer: f32,
    /// Faces, without cascades.
    pub face_count: u32,
    /// Half side of a sun's box in metres.
    pub half_extent: f32,
    /// First face of its cascades, from the widest to the narrowest.
    pub first_cascade: u32,
    /// Cascades: faces of a sun about the eye, for what is seen.
    pub cascades: u32,
    /// Half width and height of a rectangle in metres; its axes are those of its faces.
    pub half_size_m: [f32; 2],
    /// Columns and rows of a rectangle's cells, each with five faces before its middle.
    pub cells: [u32; 2],
    /// Nothing.
    pub pad: [u32; 2],
}

/// One shadow map; twin of `Face` in `light.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Face {
    /// Columns of the projection.
    pub clip_from_world: [[f32; 4]; 4],
    /// Unit vector along its rows.
    pub right: [f32; 3],
    /// Side of a texel in metres where clip w is 1.
    pub texel_at_unit_w: f32,
    /// Unit vector up its columns.
    pub up: [f32; 3],
    /// 1 where the adapter's maps of glass hold anything.
    pub panes: f32,
}

impl Face {
    /// Clip space of the face.
    pub fn projection(&self) -> Mat4 {
        Mat4::from_cols_array_2d(&self.clip_from_world)
    }
}

/// Numbers for all lights; twin of `LightCount` in `light.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct LightCount {
    /// Lights.
    pub count: u32,
    /// Texels along a face's side.
    pub side: u32,
    /// Constant offset along the normal in metres, against rounded positions.
    pub bias_m: f32,
    /// Texels by which depth may lie aside, as adapters move corners of triangles.
    pub snap: f32,
}

/// Where a picture is looked at from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Metres.
    pub position_m: Vec3,
    /// Unit direction of the view.
    pub forward: Vec3,
}

/// Room for shadow maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShadowRoom {
    /// Most lights.
    pub lights: u32,
    /// Most faces, cascades among them.
    pub faces: u32,
    /// Texels along a face's side, a power of two. More → sharper shadows, more memory.
    pub side: u32,
}

impl ShadowRoom {
    /// Room for these lights, with as many cascades as the limits allow, and faces of at most `side` texels.
    pub fn for_lights(casters: &[Caster], side: u32) -> Result<Self> {
        let faces = faces_of(casters);
        let side = side_for(faces, side);
        let most = (MAX_TEXELS / (u64::from(side) * u64::from(side))).min(MAX_FACES as u64) as usize;
        let suns = casters.iter().filter(|caster| caster.shape == Shape::Sun).count();
        let wanted = (faces + suns * CASCADES_MAX as usize).min(most).max(faces);
        let room = Self { lights: casters.len() as u32, faces: wanted as u32, side };
        room.check_lights(casters)?;
        Ok(room)
    }

    /// Room for the lights of either.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let (lights, faces) = (self.lights.max(other.lights), self.faces.max(other.faces));
        Self { lights, faces, side: self.side.min(other.side) }
    }

    /// Errs where no adapter and no processor is asked for so much.
    pub fn check(&self) -> Result<()> {
        let Self { lights, faces, side } = *self;
        let texels = u64::from(faces) * u64::from(side) * u64::from(side);
        let is_side = side.is_power_of_two() && (MIN_SIDE..=MAX_SIDE).contains(&side);
        if is_side && lights as usize <= MAX_FACES && faces as usize <= MAX_FACES && texels <= MAX_TEXELS {
            return Ok(());
        }
        let what = format!("room for {lights} lights and {faces} shadow maps of {side} texels a side");
        let problem = format!(
            "sides are powers of two in {MIN_SIDE}..={MAX_SIDE}, lights and maps at most {MAX_FACES}, their texels at most {MAX_TEXELS}"
        );
        Err(ClientError::Argument { what, problem })
    }

    /// Errs where lights do not fit.
    fn check_lights(&self, casters: &[Caster]) -> Result<()> {
        let what = || format!("{} lights", casters.len());
        let (faces, room) = (faces_of(casters), MAX_FACES.min(self.faces as usize));
        if faces > room {
            let problem = format!(
                "{faces} shadow maps are needed, at most {room}; use fewer lights, or fewer points of rectangles"
            );
            return Err(ClientError::Argument { what: what(), problem });
        }
        if casters.len() > self.lights as usize {
            let problem = format!("there is room for {}", self.lights);
            return Err(ClientError::Argument { what: what(), problem });
        }
        Ok(())
    }
}

/// Lights and the faces that they need.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowPlan {
    /// Lights.
    pub lights: Vec<Light>,
    /// Faces of all lights; cascades, which follow the eye, come last.
    pub faces: Vec<Face>,
    /// The first cascade.
    pub first_cascade: usize,
    /// Numbers for all lights.
    pub count: LightCount,
}

impl ShadowPlan {
    /// Plans shadow maps of at most `side` texels (a power of two) for `casters` over a scene with the given bounds; suns
    /// get cascades about the `eye` of a perspective.
    pub fn new(casters: &[Caster], bounds_m: [[f32; 3]; 2], side: u32, eye: Option<Eye>) -> Result<Self> {
        Self::within(&ShadowRoom::for_lights(casters, side)?, casters, bounds_m, eye)
    }

    /// Plans shadow maps within a room that is there already.
    pub fn within(
        room: &ShadowRoom,
        casters: &[Caster],
        bounds_m: [[f32; 3]; 2],
        eye: Option<Eye>,
    ) -> Result<Self> {
        room.check_lights(casters)?;
        let [low, high] = bounds_m.map(Vec3::from);
        let diagonal = (high - low).length().max(f32::MIN_POSITIVE);
        let count =
            LightCount { count: casters.len() as u32, side: room.side, bias_m: 5e-5 * diagonal, snap: SNAP };
        let mut plan = Self { lights: Vec::new(), faces: Vec::new(), first_cascade: 0, count };
        for caster in casters {
            plan.push(caster, [low, high], diagonal);
        }
        plan.first_cascade = plan.faces.len();
        if let Some(eye) = eye {
            plan.push_cascades(eye, 0.5005 * diagonal, room.faces as usize);
        }
        Ok(plan)
    }

    /// Faces of `side` texels alone: each from a point in a direction, with its half extent at distance 1, in a scene with such bounds.
    pub(in crate::passes) fn frusta(
        each: impl Iterator<Item = (Vec3, Vec3, f32)>,
        bounds_m: [[f32; 3]; 2],
        side: u32,
    ) -> Self {
        let [low, high] = bounds_m.map(Vec3::from);
        let diagonal = (high - low).length().max(f32::MIN_POSITIVE);
        let count = LightCount { count: 0, side, bias_m: 5e-5 * diagonal, snap: SNAP };
        let mut plan = Self { lights: Vec::new(), faces: Vec::new(), first_cascade: 0, count };
        for (eye, forward, tan) in each {
            plan.push_perspective(eye, forward, any_up(forward), tan, 1e-4 * diagonal);
        }
        plan
    }

    /// Room that holds this plan and no more.
    pub fn room(&self) -> ShadowRoom {
        let [lights, faces] = [self.lights.len(), self.faces.len()].map(|count| count as u32);
        ShadowRoom { lights, faces, side: self.count.side }
    }

    fn push(&mut self, caster: &Caster, corners: [Vec3; 2], diagonal: f32) {
        let centre = corners[0].lerp(corners[1], 0.5);
        let sun = caster.shape == Shape::Sun;
        let half_extent = if sun { sun_half_extent(caster.direction, corners) } else { 0.0 };
        let position = if sun { centre } else { caster.position };
        self.lights.push(Light {
            position: position.into(),
            range_m: caster.range,
            direction: caster.direction.into(),
            shape: caster.shape as u32,
            strength: caster.strength.into(),
            first_face: self.faces.len() as u32,
            cone_cos_inner: caster.cone[0],
            cone_cos_outer: caster.cone[1],
            face_count: face_count(caster),
            half_extent,
            first_cascade: 0,
            cascades: 0,
            half_size_m: [caster.half_u_m.length(), caster.half_v_m.length()],
            cells: caster.cells,
            pad: [0; 2],
        });
        let near = 1e-4 * diagonal;
        match face_count(caster) {
            _ if caster.shape == Shape::Rect => self.push_rect(caster, near),
            _ if sun => self.push_sun(caster.direction, centre, half_extent, 0.5005 * diagonal),
            6 => {
                for (forward, up) in CUBE {
                    self.push_perspective(position, forward, up, 1.0, near);
                }
            }
            _ => {
                let cos = caster.cone[1].max(0.01);
                let tan = (1.0 - cos * cos).max(0.0).sqrt() / cos;
                self.push_perspective(position, caster.direction, any_up(caster.direction), tan, near);
            }
        }
    }

    fn push_perspective(&mut self, eye: Vec3, forward: Vec3, up: Vec3, tan: f32, near: f32) {
        let side = self.count.side as f32;
        let tan = tan * side / (side - 2.0 * GUARD_TEXELS);
        let view = look_along(eye, forward, up);
        self.push_face(perspective(tan, tan, near) * view, view, 2.0 * tan / side);
    }

    /// Half a cube before the middle of each cell, row by row; in each the face along the light comes last.
    fn push_rect(&mut self, caster: &Caster, near: f32) {
        let [columns, rows] = caster.cells;
        let axes = [caster.half_u_m.normalize(), caster.half_v_m.normalize(), caster.direction];
        let in_world = |local: Vec3| axes[0] * local.x + axes[1] * local.y + axes[2] * local.z;
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let along = |index: u32, count: u32| (2 * index + 1) as f32 / count as f32 - 1.0;
            let middle = caster.position
                + caster.half_u_m * along(column, columns)
                + caster.half_v_m * along(row, rows);
            for (forward, up) in &CUBE[..RECT_FACES as usize] {
                self.push_perspective(middle, in_world(*forward), in_world(*up), 1.0, near);
            }
        }
    }

    /// `half_extent` across and `reach` along the light, from the centre, in metres.
    fn push_sun(&mut self, direction: Vec3, centre: Vec3, half_extent: f32, reach: f32) {
        let side = self.count.side as f32;
        let tiles = SUN_TILES as f32;
        let half_tile = half_extent / tiles;
        let half = half_tile * side / (side - 2.0 * GUARD_TEXELS);
        let view = look_along(centre - direction * reach, direction, any_up(direction));
        for row in 0..SUN_TILES {
            for column in 0..SUN_TILES {
                let offset = |index: u32| (2.0 * index as f32 + 1.0 - tiles) * half_tile;
                let shift = Mat4::from_translation(Vec3::new(-offset(column), -offset(row), 0.0));
                let projection = parallel(half, half, 2.0 * reach) * shift;
                self.push_face(projection * view, view, 2.0 * half / side);
            }
        }
    }

    /// Cascades of every sun, as long as there is room for `faces_max` faces.
    fn push_cascades(&mut self, eye: Eye, reach: f32, faces_max: usize) {
        let side = self.count.side as f32;
        let finest_m = FINEST_M * (2.0 * reach).min(1.0);
        for index in 0..self.lights.len() {
            let light = self.lights[index];
            let [centre, direction] = [light.position, light.direction].map(Vec3::from);
            self.lights[index].first_cascade = self.faces.len() as u32;
            for cascade in 0..CASCADES_MAX {
                // Texels of a tile are as wide as half the box over the side.
                let half = 0.5 * light.half_extent / CASCADE_STEP.powi(cascade as i32 + 1);
                let texel_m = 2.0 * half / side;
                let is_full = self.faces.len() >= faces_max;
                if light.shape != Shape::Sun as u32 || texel_m < finest_m || is_full {
                    break;
                }
                let view = look_along(centre - direction * reach, direction, any_up(direction));
                // Most of it lies before the eye, and it moves by whole texels.
                let middle = view.transform_point3(eye.position_m + eye.forward * (0.75 * half));
                let snapped = (middle / texel_m).round() * texel_m;
                let shift = Mat4::from_translation(Vec3::new(-snapped.x, -snapped.y, 0.0));
                self.push_face(parallel(half, half, 2.0 * reach) * shift * view, view, texel_m);
                self.lights[index].cascades += 1;
            }
        }
    }

    fn push_face(&mut self, clip_from_world: Mat4, view: Mat4, texel_at_unit_w: f32) {
        self.faces.push(Face {
            clip_from_world: clip_from_world.to_cols_array_2d(),
            right: view.row(0).truncate().into(),
            texel_at_unit_w,
            up: view.row(1).truncate().into(),
            panes: 0.0,
        });
    }
}

/// Directions of a cube's faces and their up vectors, in the order of `cube_face`; the first five are before a rectangle.
const CUBE: [(Vec3, Vec3); 6] = [
    (Vec3::X, Vec3::Y),
    (Vec3::NEG_X, Vec3::Y),
    (Vec3::Y, Vec3::Z),
    (Vec3::NEG_Y, Vec3::Z),
    (Vec3::Z, Vec3::Y),
    (Vec3::NEG_Z, Vec3::Y),
];

fn any_up(forward: Vec3) -> Vec3 {
    if forward.y.abs() > 0.9 { Vec3::X } else { Vec3::Y }
}

/// Half side of the square across a sun's light that holds the whole box, in metres.
fn sun_half_extent(direction: Vec3, corners: [Vec3; 2]) -> f32 {
    let half_size = 0.5 * (corners[1] - corners[0]).abs();
    let view = look_along(Vec3::ZERO, direction, any_up(direction));
    let half = |axis: usize| view.row(axis).truncate().abs().dot(half_size);
    (1.001 * half(0).max(half(1))).max(f32::MIN_POSITIVE)
}

fn faces_of(casters: &[Caster]) -> usize {
    casters.iter().map(|caster| face_count(caster) as usize).sum()
}

fn face_count(caster: &Caster) -> u32 {
    match caster.shape {
        Shape::Sun => SUN_TILES * SUN_TILES,
        Shape::Spot if caster.cone[1] >= SPOT_COS_MIN => 1,
        Shape::Rect => RECT_FACES * caster.cells[0] * caster.cells[1],
        Shape::Point | Shape::Spot => 6,
    }
}

/// The longest side, `wanted` or that halved, with which all faces stay within [`MAX_TEXELS`].
fn side_for(faces: usize, wanted: u32) -> u32 {
    let mut side = wanted;
    while faces as u64 * u64::from(side) * u64::from(side) > MAX_TEXELS {
        side /= 2;
    }
    side
}
