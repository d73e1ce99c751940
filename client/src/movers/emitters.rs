//! Emitters of a bake as a few points, those that send most light to a place: a cut through groups of their triangles \[Walter2005\], the group
//! that tells most being split until there are enough.

use glam::{Affine3A, Vec3};
use lightkiln_proto::transfer::{TransferTable, viewpoint_places};

use super::{ball_of, is_long, is_open};
use crate::bake::{LoadedBake, emitter_radiance};
use crate::passes::shade::surface::mapped_uv;
use crate::passes::transfer::{EMITTER_POINTS, EmitterPoint};
use crate::scene::{LoadedDraw, LoadedScene};

/// Share of all light that a group sends below which it is split no further.
const TELLING: f32 = 1e-3;
/// Share of the way to an emitter within which what stands there hides it.
const BEFORE: f32 = 0.98;
/// Size of a group in its distance up to which a point stands for it, and from which on it does not.
const RESOLVED: [f32; 2] = [0.4, 0.8];

/// Emissive triangles of a scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct Emitters {
    triangles: Vec<Triangle>,
}

/// Points of emitters before an object.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// At most [`EMITTER_POINTS`].
    pub(crate) points: Vec<EmitterPoint>,
    /// Of each emitter the share of its light for which they stand; walks tell of the rest.
    pub(crate) shares: Vec<f32>,
}

/// A triangle that shines to one side.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    corners_m: [Vec3; 3],
    /// Half of the cross product of its sides, in m².
    area: Vec3,
    emitter: u16,
    /// Share of the emitter's radiance, by its texture.
    share: Vec3,
}

/// A part of a triangle, as a place sees it.
#[derive(Clone, Copy, Debug)]
struct Piece {
    triangle: Triangle,
    radiance: Vec3,
    /// What it sends to the place: irradiance of a surface that faces it, in luminance.
    sent: f32,
}

/// Pieces of one emitter for which one point stands.
#[derive(Clone, Debug)]
struct Group {
    pieces: Vec<Piece>,
    sent: f32,
    /// Its size in its distance.
    size: f32,
}

impl Emitters {
    /// Of the bake's own meshes.
    pub(crate) fn of(scene: &LoadedScene) -> Self {
        let own = &scene.draws.draws[..scene.own_draws()];
        Self { triangles: own.iter().flat_map(|draw| triangles_of(scene, draw)).collect() }
    }

    /// Those before an object where it stands, under such scales of them: of each what the object's viewpoints see of it.
    pub(crate) fn before(
        &self,
        bake: &LoadedBake,
        emitter_scale: &[f32],
        (volume, world_from_object): (&TransferTable, &Affine3A),
    ) -> Before {
        let Some((voxels, _)) = bake.light.voxels() else { return Before::default() };
        let (middle_m, _) = ball_of(volume, world_from_object);
        let viewpoints = viewpoint_places(volume.box_m(), is_long(volume, world_from_object));
        let viewpoints: Vec<Vec3> = viewpoints
            .into_iter()
            .map(|at_m| world_from_object.transform_point3(at_m))
            .filter(|at_m| is_open(voxels, middle_m, *at_m))
            .collect();
        let mut before = self.cut(&emitter_radiance(&bake.scene.manifest, emitter_scale), middle_m);
        for point in &mut before.points {
            // The emitter itself is not in the way.
            let sees = |from_m: &&Vec3| is_open(voxels, **from_m, from_m.lerp(point.position_m, BEFORE));
            let seeing = viewpoints.iter().filter(sees).count();
            point.radiant *= seeing as f32 / viewpoints.len().max(1) as f32;
        }
        before.points.retain(|point| point.radiant != Vec3::ZERO);
        before
    }

    /// Those that send light to a place, by the radiance of each emitter.
    fn cut(&self, radiance: &[Vec3], to_m: Vec3) -> Before {
        let mut groups: Vec<Group> = Vec::new();
        let mut by_emitter = vec![Vec::new(); radiance.len()];
        for triangle in &self.triangles {
            let Some(own) = by_emitter.get_mut(usize::from(triangle.emitter)) else { continue };
            let emitter = radiance[usize::from(triangle.emitter)];
            own.push(Piece::new(*triangle, emitter * triangle.share, to_m));
        }
        for mut own in by_emitter {
            own.retain(|piece| piece.sent > 0.0);
            if !own.is_empty() {
                groups.push(Group::new(own, to_m));
            }
        }
        let total: f32 = groups.iter().map(|group| group.sent).sum();
        groups.sort_by(|a, b| b.sent.total_cmp(&a.sent));
        groups.truncate(EMITTER_POINTS);
        while groups.len() < EMITTER_POINTS {
            let telling = |index: &usize| groups[*index].telling();
            let most = (0..groups.len()).max_by(|a, b| telling(a).total_cmp(&telling(b)));
            let Some(most) = most.filter(|most| telling(most) > TELLING * total) else { break };
            let halves = groups[most].halves(to_m);
            groups.splice(most..=most, halves);
        }
        let shares: Vec<f32> = (0..radiance.len()).map(|emitter| share_of(&groups, emitter)).collect();
        let of = |group: &Group| {
            let point = group.point();
            EmitterPoint { radiant: point.radiant * shares[group.emitter()], ..point }
        };
        Before { points: groups.iter().map(of).collect(), shares }
    }
}

/// Share of an emitter's light for which points stand.
fn share_of(groups: &[Group], emitter: usize) -> f32 {
    let own = || groups.iter().filter(|group| group.emitter() == emitter);
    let sent: f32 = own().map(|group| group.sent).sum();
    let resolved: f32 = own().map(|group| group.sent * group.resolved()).sum();
    if sent > 0.0 { resolved / sent } else { 0.0 }
}

impl Piece {
    fn new(triangle: Triangle, radiance: Vec3, to_m: Vec3) -> Self {
        let mut piece = Self { triangle, radiance, sent: 0.0 };
        let light = piece.point().irradiance(to_m, None);
        piece.sent = light.dot(Vec3::new(0.2126, 0.7152, 0.0722));
        piece
    }

    fn point(&self) -> EmitterPoint {
        let area_m2 = self.triangle.area.length();
        EmitterPoint {
            position_m: self.middle_m(),
            area_m2,
            radiant: self.radiance * area_m2,
            flatness: 1.0,
            normal: self.triangle.area.normalize_or_zero(),
        }
    }

    fn middle_m(&self) -> Vec3 {
        self.triangle.corners_m.iter().sum::<Vec3>() / 3.0
    }

    /// Halves by its longest side.
    fn halves(&self, to_m: Vec3) -> [Self; 2] {
        let corners = self.triangle.corners_m;
        let length = |side: usize| (corners[(side + 1) % 3] - corners[side]).length_squared();
        let longest = (0..3).max_by(|a, b| length(*a).total_cmp(&length(*b))).unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|corner| corners[(longest + corner) % 3]);
        let middle = 0.5 * (a + b);
        [[a, middle, c], [middle, b, c]].map(|corners_m| {
            let triangle = Triangle { corners_m, area: 0.5 * self.triangle.area, ..self.triangle };
            Self::new(triangle, self.radiance, to_m)
        })
    }
}

impl Group {
    fn new(pieces: Vec<Piece>, to_m: Vec3) -> Self {
        let sent = pieces.iter().map(|piece| piece.sent).sum();
        let corners = || pieces.iter().flat_map(|piece| piece.triangle.corners_m);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let distance_m = (to_m.clamp(low, high) - to_m).length();
        let size = (high - low).length() / distance_m.max(f32::MIN_POSITIVE);
        Self { pieces, sent, size }
    }

    fn emitter(&self) -> usize {
        self.pieces.first().map_or(0, |piece| usize::from(piece.triangle.emitter))
    }

    /// How much its halves tell.
    fn telling(&self) -> f32 {
        self.sent * self.size.min(2.0)
    }

    /// Share of it for which a point stands.
    fn resolved(&self) -> f32 {
        let [whole, none] = RESOLVED;
        ((none - self.size) / (none - whole)).clamp(0.0, 1.0)
    }

    fn halves(&mut self, to_m: Vec3) -> [Self; 2] {
        if let [piece] = self.pieces[..] {
            return piece.halves(to_m).map(|piece| Self::new(vec![piece], to_m));
        }
        let middles = || self.pieces.iter().map(Piece::middle_m);
        let low = middles().fold(Vec3::INFINITY, Vec3::min);
        let high = middles().fold(Vec3::NEG_INFINITY, Vec3::max);
        let axis = (high - low).max_position();
        let mut pieces = std::mem::take(&mut self.pieces);
        pieces.sort_by(|a, b| a.middle_m()[axis].total_cmp(&b.middle_m()[axis]));
        let mut sum = 0.0;
        let half = pieces.iter().position(|piece| {
            sum += piece.sent;
            2.0 * sum >= self.sent
        });
        let after = pieces.split_off((half.unwrap_or(0) + 1).min(pieces.len() - 1));
        [Self::new(pieces, to_m), Self::new(after, to_m)]
    }

    /// Its point: at the piece nearest to its middle, as there may be nothing there.
    fn point(&self) -> EmitterPoint {
        let total = self.sent.max(f32::MIN_POSITIVE);
        let mean = |of: fn(&Piece) -> Vec3| {
            self.pieces.iter().map(|piece| of(piece) * piece.sent).sum::<Vec3>() / total
        };
        let normal = mean(|piece| piece.triangle.area.normalize_or_zero());
        let middle_m = mean(Piece::middle_m);
        let places = || self.pieces.iter().map(Piece::middle_m);
        let away = |at_m: &Vec3| at_m.distance_squared(middle_m);
        EmitterPoint {
            position_m: places().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(middle_m),
            area_m2: self.pieces.iter().map(|piece| piece.triangle.area.length()).sum(),
            radiant: self.pieces.iter().map(|piece| piece.point().radiant).sum(),
            flatness: normal.length().min(1.0),
            normal: normal.normalize_or_zero(),
        }
    }
}

fn triangles_of<'a>(scene: &'a LoadedScene, draw: &'a LoadedDraw) -> impl Iterator<Item = Triangle> + 'a {
    let material = &scene.manifest.materials[draw.material as usize];
    let of = move |corners: &[u32; 3], emitter: u16| {
        let vertices = corners.map(|corner| &draw.vertices[corner as usize]);
        let corners_m = vertices.map(|vertex| Vec3::from(vertex.position_m));
        let area = 0.5 * (corners_m[1] - corners_m[0]).cross(corners_m[2] - corners_m[0]);
        let share = material.emissive_texture.as_ref().map_or(Vec3::ONE, |used| {
            let [a, b, c] = vertices.map(|vertex| mapped_uv(used, vertex.uv));
            let along = |to: [f32; 2]| [to[0] - a[0], to[1] - a[1]];
            let middle = [0, 1].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
            let texture = &scene.textures[used.texture as usize];
            texture.sample(middle, used.wrap, texture.lod(along(b), along(c))).truncate()
        });
        let front = Triangle { corners_m, area, emitter, share };
        let back = Triangle { area: -area, ..front };
        [Some(front), material.double_sided.then_some(back)].into_iter().flatten()
    };
    let emitter = material.emitter.filter(|_| material.emissive != [0.0; 3]);
    emitter
        .into_iter()
        .flat_map(move |emitter| draw.triangles.iter().flat_map(move |corners| of(corners, emitter)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rectangle of half sides u and v, which shines along u × v.
    fn rectangle(middle_m: Vec3, [u, v]: [Vec3; 2], emitter: u16) -> [Triangle; 2] {
        let [a, b, c, d] = [-u - v, u - v, u + v, v - u].map(|corner| middle_m + corner);
        [[a, b, c], [a, c, d]].map(|corners_m| Triangle {
            corners_m,
            area: 2.0 * u.cross(v),
            emitter,
            share: Vec3::ONE,
        })
    }

    /// A lamp at a ceiling.
    fn panel(middle_m: Vec3, half_m: f32, emitter: u16) -> [Triangle; 2] {
        rectangle(middle_m, [Vec3::X * half_m, Vec3::Z * (0.8 * half_m)], emitter)
    }

    /// ∫ cosθ dω over a rectangle of half sides u and v, in many cells.
    fn factor(middle_m: Vec3, u: Vec3, v: Vec3, normal: Vec3) -> f32 {
        let along = |step: i32| (step as f32 + 0.5) / 32.0;
        let cells = (-32..32).flat_map(|row| (-32..32).map(move |column| (row, column)));
        let of_cell = |(row, column): (i32, i32)| {
            let way_m = middle_m + u * along(column) + v * along(row);
            let squared = way_m.length_squared();
            let facing = u.cross(v).dot(-way_m).max(0.0) / 1024.0;
            normal.dot(way_m).max(0.0) * facing / (squared * squared)
        };
        cells.map(of_cell).sum()
    }

    /// Sixteen points light what is around as the panel does, and none stands behind it.
    #[test]
    fn points_of_a_panel_light_as_it_does() {
        let middle_m = Vec3::Y * 3.0;
        let emitters = Emitters { triangles: panel(middle_m, 0.6, 0).to_vec() };
        let Before { points, shares } = emitters.cut(&[Vec3::splat(2.0)], Vec3::new(0.4, 1.0, 0.2));
        assert_eq!((points.len(), shares), (EMITTER_POINTS, vec![1.0]));
        let (mut worst, mut lit) = (0.0_f32, 0);
        for step in 0..64 {
            let direction = lightkiln_proto::harmonics::relight_direction(step, 64);
            let at_m = Vec3::new(2.0 * direction.x, 1.0 + direction.y, 2.0 * direction.z);
            for normal in [Vec3::Y, Vec3::X, -direction] {
                let wanted = 2.0 * factor(middle_m - at_m, Vec3::X * 0.6, Vec3::Z * 0.48, normal);
                let found: Vec3 = points.iter().map(|point| point.irradiance(at_m, Some(normal))).sum();
                if wanted > 0.02 {
                    worst = worst.max((found.x / wanted - 1.0).abs());
                    lit += 1;
                }
            }
        }
        assert!(lit > 60 && worst < 0.04, "{worst} of {lit}");
        assert!(emitters.cut(&[Vec3::ONE], Vec3::Y * 4.0).points.is_empty());
        assert!(emitters.cut(&[Vec3::ZERO], Vec3::Y).points.is_empty());
    }

    /// A ceiling that shines all over is left to walks, and so are the weakest of many lamps; what stands nearer is split finer.
    #[test]
    fn wide_emitters_and_the_weakest_are_left_to_walks() {
        let ceiling = Emitters { triangles: panel(Vec3::Y * 2.5, 6.0, 0).to_vec() };
        let Before { points, shares } = ceiling.cut(&[Vec3::ONE], Vec3::Y);
        assert!(shares[0] < 0.5, "{shares:?}");
        let whole: f32 = points.iter().map(|point| point.area_m2).sum();
        let radiant: f32 = points.iter().map(|point| point.radiant.x).sum();
        assert!((whole / 115.2 - 1.0).abs() < 1e-3 && (radiant - whole * shares[0]).abs() < 1e-3 * whole);
        let row = |lamp: u16| panel(Vec3::new(3.0 * f32::from(lamp), 3.0, 0.0), 0.05, lamp);
        let lamps = Emitters { triangles: (0..40).flat_map(row).collect() };
        let Before { points, shares } = lamps.cut(&[Vec3::ONE; 40], Vec3::Y);
        assert_eq!(points.len(), EMITTER_POINTS);
        assert!(
            shares[..16].iter().all(|share| *share == 1.0) && shares[16..].iter().all(|share| *share == 0.0)
        );
        let two = Emitters {
            triangles: [panel(Vec3::Y * 3.0, 0.5, 0), panel(Vec3::new(8.0, 3.0, 0.0), 0.5, 0)].concat(),
        };
        let near = two.cut(&[Vec3::ONE], Vec3::Y).points;
        assert!(near.iter().filter(|point| point.position_m.x < 4.0).count() > 8);
    }
}
