//! Emitters of a bake as a few points, those that send most light to a place: a cut through groups of their triangles \[Walter2005\], the group
//! that tells most being split until there are enough.

use glam::{Affine3A, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::transfer::{TransferTable, ViewpointLattice};
use lightkiln_proto::voxels::{Start, VoxelTable, walk, walk_within};

use super::{ball_of, is_open};
use crate::bake::{LoadedBake, emitter_radiance};
use crate::passes::shade::surface::mapped_uv;
use crate::passes::shadow::EMITTER_POINTS;
use crate::passes::transfer::EmitterPoint;
use crate::scene::{LoadedDraw, LoadedScene};

/// Share of all light that a group sends below which it is split no further.
const TELLING: f32 = 1e-3;
/// Way before an emitter on which nothing hides it: a share of the whole, and of the side of a voxel.
const BEFORE: [f32; 2] = [0.02, 0.5];
/// Ways from a viewpoint that tell whether it lies in geometry.
const WAYS: u32 = 16;
/// Most places of a group that are looked for.
const WITNESSES: usize = 4;
/// Distance from an object's middle, in radii, from which on a point stands for a group, and up to which it does not: from nearer ones it cannot be
/// seen whole.
const OUTSIDE: [f32; 2] = [1.3, 1.05];
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

/// Viewpoints of an object, which see emitters.
#[derive(Clone, Copy, Debug)]
struct Seeing<'a> {
    from_m: &'a [Vec3],
    /// Middle and radius of its ball.
    middle_m: Vec3,
    radius_m: f32,
}

/// A part of a triangle, as an object sees it.
#[derive(Clone, Copy, Debug)]
struct Piece {
    triangle: Triangle,
    radiance: Vec3,
    /// Irradiance that it sends to the object, of a surface that faces it, in luminance, as a mean over viewpoints.
    sent: f32,
}

/// Pieces of one emitter for which one point stands.
#[derive(Clone, Debug)]
struct Group {
    pieces: Vec<Piece>,
    sent: f32,
    /// Its size in its distance.
    size: f32,
    /// Its distance from the object's middle, in radii of its ball.
    distance: f32,
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
        let (middle_m, radius_m) = ball_of(volume, world_from_object);
        let viewpoints: Vec<Vec3> = ViewpointLattice::of_corners(volume.box_m())
            .places()
            .map(|at_m| world_from_object.transform_point3(at_m))
            .filter(|at_m| is_open(voxels, middle_m, *at_m) && is_free(voxels, *at_m))
            .collect();
        let seeing = Seeing { from_m: &viewpoints, middle_m, radius_m };
        let (groups, shares) = self.cut(&emitter_radiance(&bake.scene.manifest, emitter_scale), seeing);
        let of = |group: &Group| {
            let point = group.point(seeing);
            let share = shares[group.emitter()] * group.in_sight(voxels, seeing);
            EmitterPoint { radiant: point.radiant * share, ..point }
        };
        let points = groups.iter().map(of).filter(|point| point.radiant != Vec3::ZERO).collect();
        Before { points, shares }
    }

    /// Groups that send light to an object, by the radiance of each emitter, and of each emitter the share for which their points stand.
    fn cut(&self, radiance: &[Vec3], seeing: Seeing<'_>) -> (Vec<Group>, Vec<f32>) {
        let mut groups: Vec<Group> = Vec::new();
        let mut by_emitter = vec![Vec::new(); radiance.len()];
        for triangle in &self.triangles {
            let Some(own) = by_emitter.get_mut(usize::from(triangle.emitter)) else { continue };
            let emitter = radiance[usize::from(triangle.emitter)];
            own.push(Piece::new(*triangle, emitter * triangle.share, seeing));
        }
        for mut own in by_emitter {
            own.retain(|piece| piece.sent > 0.0);
            if !own.is_empty() {
                groups.push(Group::new(own, seeing));
            }
        }
        let total: f32 = groups.iter().map(|group| group.sent).sum();
        groups.sort_by(|a, b| b.sent.total_cmp(&a.sent));
        groups.truncate(EMITTER_POINTS);
        while groups.len() < EMITTER_POINTS {
            let telling = |index: &usize| groups[*index].telling();
            let most = (0..groups.len()).max_by(|a, b| telling(a).total_cmp(&telling(b)));
            let Some(most) = most.filter(|most| telling(most) > TELLING * total) else { break };
            let halves = groups[most].halves(seeing);
            groups.splice(most..=most, halves);
        }
        let shares = (0..radiance.len()).map(|emitter| share_of(&groups, emitter)).collect();
        (groups, shares)
    }
}

/// A place lies in no geometry: few ways from there end at backs.
fn is_free(voxels: &VoxelTable, at_m: Vec3) -> bool {
    let start = Start::free(at_m);
    let ends_at_back =
        |way: &u32| walk(voxels, &start, relight_direction(*way, WAYS), 0.0).is_some_and(|hit| hit.is_back);
    (0..WAYS).filter(ends_at_back).count() as u32 <= WAYS / 4
}

/// Nothing stands between a place and a piece of an emitter, either side of it.
fn sees(voxels: &VoxelTable, from_m: Vec3, piece_m: Vec3) -> bool {
    let way_m = piece_m - from_m;
    let length_m = way_m.length();
    let [of_way, of_voxel] = BEFORE;
    let before_m = length_m - (of_way * length_m).max(of_voxel * voxels.voxel_m);
    before_m <= 0.0 || walk_within(voxels, &Start::free(from_m), way_m / length_m, 0.0, before_m).is_none()
}

/// Share of an emitter's light for which points stand.
fn share_of(groups: &[Group], emitter: usize) -> f32 {
    let own = || groups.iter().filter(|group| group.emitter() == emitter);
    let sent: f32 = own().map(|group| group.sent).sum();
    let resolved: f32 = own().map(|group| group.sent * group.resolved()).sum();
    if sent > 0.0 { resolved / sent } else { 0.0 }
}

impl Seeing<'_> {
    /// Irradiance that a point sends, in luminance, as a mean over viewpoints.
    fn sent_by(&self, point: &EmitterPoint) -> f32 {
        let light: Vec3 = self.from_m.iter().map(|at_m| point.irradiance(*at_m, None)).sum();
        light.dot(Vec3::new(0.2126, 0.7152, 0.0722)) / self.from_m.len().max(1) as f32
    }
}

impl Piece {
    fn new(triangle: Triangle, radiance: Vec3, seeing: Seeing<'_>) -> Self {
        let mut piece = Self { triangle, radiance, sent: 0.0 };
        piece.sent = seeing.sent_by(&piece.point());
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
    fn halves(&self, seeing: Seeing<'_>) -> [Self; 2] {
        let corners = self.triangle.corners_m;
        let length = |side: usize| (corners[(side + 1) % 3] - corners[side]).length_squared();
        let longest = (0..3).max_by(|a, b| length(*a).total_cmp(&length(*b))).unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|corner| corners[(longest + corner) % 3]);
        let middle = 0.5 * (a + b);
        [[a, middle, c], [middle, b, c]].map(|corners_m| {
            let triangle = Triangle { corners_m, area: 0.5 * self.triangle.area, ..self.triangle };
            Self::new(triangle, self.radiance, seeing)
        })
    }
}

impl Group {
    fn new(pieces: Vec<Piece>, seeing: Seeing<'_>) -> Self {
        let sent = pieces.iter().map(|piece| piece.sent).sum();
        let corners = || pieces.iter().flat_map(|piece| piece.triangle.corners_m);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let distance_m = (seeing.middle_m.clamp(low, high) - seeing.middle_m).length();
        let size = (high - low).length() / distance_m.max(f32::MIN_POSITIVE);
        Self { pieces, sent, size, distance: distance_m / seeing.radius_m.max(f32::MIN_POSITIVE) }
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
        let by_size = ((none - self.size) / (none - whole)).clamp(0.0, 1.0);
        let [outside, inside] = OUTSIDE;
        by_size * ((self.distance - inside) / (outside - inside)).clamp(0.0, 1.0)
    }

    fn halves(&mut self, seeing: Seeing<'_>) -> [Self; 2] {
        if let [piece] = self.pieces[..] {
            return piece.halves(seeing).map(|piece| Self::new(vec![piece], seeing));
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
        [Self::new(pieces, seeing), Self::new(after, seeing)]
    }

    /// Its point, which sends as much to the object as its pieces do: at the piece nearest to its middle, as there may be nothing there.
    fn point(&self, seeing: Seeing<'_>) -> EmitterPoint {
        let total = self.sent.max(f32::MIN_POSITIVE);
        let mean = |of: fn(&Piece) -> Vec3| {
            self.pieces.iter().map(|piece| of(piece) * piece.sent).sum::<Vec3>() / total
        };
        let normal = mean(|piece| piece.triangle.area.normalize_or_zero());
        let middle_m = mean(Piece::middle_m);
        let places = || self.pieces.iter().map(Piece::middle_m);
        let away = |at_m: &Vec3| at_m.distance_squared(middle_m);
        let point = EmitterPoint {
            position_m: places().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or(middle_m),
            area_m2: self.pieces.iter().map(|piece| piece.triangle.area.length()).sum(),
            radiant: self.pieces.iter().map(|piece| piece.point().radiant).sum(),
            flatness: normal.length().min(1.0),
            normal: normal.normalize_or_zero(),
        };
        let sent = seeing.sent_by(&point);
        let scale = if sent > 0.0 { self.sent / sent } else { 0.0 };
        EmitterPoint { radiant: point.radiant * scale, ..point }
    }

    /// Share of it that an object's viewpoints see: of some of its pieces, each for as much light as all that come before the next.
    fn in_sight(&self, voxels: &VoxelTable, seeing: Seeing<'_>) -> f32 {
        let count = self.pieces.len().min(WITNESSES);
        let mut sums = self.pieces.iter().scan(0.0, |sum, piece| {
            *sum += piece.sent;
            Some((*sum, piece.middle_m()))
        });
        let witness = |index: usize| {
            let wanted = (index as f32 + 0.5) / count as f32 * self.sent;
            sums.find(|(sum, _)| *sum >= wanted).map(|(_, middle_m)| middle_m)
        };
        let mut witnesses: Vec<Vec3> = (0..count).filter_map(witness).collect();
        if witnesses.is_empty() {
            witnesses.extend(self.pieces.first().map(Piece::middle_m));
        }
        let from = |at_m: &Vec3| witnesses.iter().filter(|piece_m| sees(voxels, *at_m, **piece_m)).count();
        let seen: usize = seeing.from_m.iter().map(from).sum();
        seen as f32 / (witnesses.len() * seeing.from_m.len()).max(1) as f32
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

    /// Points, each for its share, and shares, as a place sees them.
    fn cut(emitters: &Emitters, radiance: &[Vec3], at_m: Vec3) -> (Vec<EmitterPoint>, Vec<f32>) {
        let seeing = Seeing { from_m: &[at_m], middle_m: at_m, radius_m: 0.1 };
        let (groups, shares) = emitters.cut(radiance, seeing);
        let of = |group: &Group| {
            let point = group.point(seeing);
            EmitterPoint { radiant: point.radiant * shares[group.emitter()], ..point }
        };
        (groups.iter().map(of).collect(), shares)
    }

    /// Points of a ball and of a tube give a place what these give it, whichever way a surface faces there.
    #[test]
    fn points_of_round_lamps_send_as_much_as_they_do() {
        let around = |step: u32, steps: u32| std::f32::consts::TAU * step as f32 / steps as f32;
        let ball = |lat: u32, lon: u32| {
            let (polar, turn) = (0.5 * around(lat, 12), around(lon, 24));
            Vec3::new(polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin()) * 0.1
        };
        let tube = |end: u32, lon: u32| {
            Vec3::new(
                1.2 * end as f32 / 12.0 - 0.6,
                0.02 * around(lon, 24).cos(),
                0.02 * around(lon, 24).sin(),
            )
        };
        let mesh = |at: &dyn Fn(u32, u32) -> Vec3, middle_m: Vec3| -> Vec<Triangle> {
            let quads = (0..12).flat_map(|row| (0..24).map(move |column| (row, column)));
            let of_quad = |(row, column): (u32, u32)| {
                let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| at(row + i, column + j));
                [[a, b, c], [a, c, d]].map(|corners| {
                    let area = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                    let middle = (corners[0] + corners[1] + corners[2]) / 3.0 * Vec3::new(0.0, 1.0, 1.0);
                    let outwards = if middle.dot(area) < 0.0 { -area } else { area };
                    let corners_m = corners.map(|corner| middle_m + corner);
                    Triangle { corners_m, area: outwards, emitter: 0, share: Vec3::ONE }
                })
            };
            quads.flat_map(of_quad).collect()
        };
        let at_m = Vec3::new(0.3, 0.1, -0.2);
        for triangles in [mesh(&ball, Vec3::Y * 2.0), mesh(&tube, Vec3::Y * 2.0)] {
            let exact = |normal: Vec3| -> f32 {
                let of = |triangle: &Triangle| {
                    let middle_m = triangle.corners_m.iter().sum::<Vec3>() / 3.0;
                    let way_m = middle_m - at_m;
                    let facing = triangle.area.dot(-way_m).max(0.0);
                    normal.dot(way_m).max(0.0) * facing / way_m.length_squared().powi(2)
                };
                triangles.iter().map(of).sum()
            };
            let emitters = Emitters { triangles: triangles.clone() };
            let (points, shares) = cut(&emitters, &[Vec3::ONE], at_m);
            assert!(!points.is_empty() && shares[0] > 0.9, "{shares:?}");
            for normal in [Vec3::Y, Vec3::new(0.6, 0.8, 0.0)] {
                let found: f32 = points.iter().map(|point| point.irradiance(at_m, Some(normal)).x).sum();
                let ratio = found / (exact(normal) * shares[0]);
                assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
            }
        }
    }

    /// Sixteen points light what is around as the panel does, and none stands behind it.
    #[test]
    fn points_of_a_panel_light_as_it_does() {
        let middle_m = Vec3::Y * 3.0;
        let emitters = Emitters { triangles: panel(middle_m, 0.6, 0).to_vec() };
        let (points, shares) = cut(&emitters, &[Vec3::splat(2.0)], Vec3::new(0.4, 1.0, 0.2));
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
        assert!(cut(&emitters, &[Vec3::ONE], Vec3::Y * 4.0).0.is_empty());
        assert!(cut(&emitters, &[Vec3::ZERO], Vec3::Y).0.is_empty());
    }

    /// A ceiling that shines all over is left to walks, and so are the weakest of many lamps; what stands nearer is split finer.
    #[test]
    fn wide_emitters_and_the_weakest_are_left_to_walks() {
        let ceiling = Emitters { triangles: panel(Vec3::Y * 2.5, 6.0, 0).to_vec() };
        let (points, shares) = cut(&ceiling, &[Vec3::ONE], Vec3::Y);
        assert!(shares[0] < 0.5, "{shares:?}");
        let whole: f32 = points.iter().map(|point| point.area_m2).sum();
        let radiant: f32 = points.iter().map(|point| point.radiant.x).sum();
        assert!(
            (whole / 115.2 - 1.0).abs() < 1e-3 && radiant >= 0.5 * whole * shares[0] && radiant < 1.5 * whole
        );
        let row = |lamp: u16| panel(Vec3::new(3.0 * f32::from(lamp), 3.0, 0.0), 0.05, lamp);
        let lamps = Emitters { triangles: (0..40).flat_map(row).collect() };
        let (points, shares) = cut(&lamps, &[Vec3::ONE; 40], Vec3::Y);
        assert_eq!(points.len(), EMITTER_POINTS);
        assert!(
            shares[..16].iter().all(|share| *share == 1.0) && shares[16..].iter().all(|share| *share == 0.0)
        );
        let two = Emitters {
            triangles: [panel(Vec3::Y * 3.0, 0.5, 0), panel(Vec3::new(8.0, 3.0, 0.0), 0.5, 0)].concat(),
        };
        let near = cut(&two, &[Vec3::ONE], Vec3::Y).0;
        assert!(near.iter().filter(|point| point.position_m.x < 4.0).count() > 8);
    }
}
