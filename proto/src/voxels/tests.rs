//! Chunks of surfaces: how short they are, which levels a prefix has, and faults that a decoder refuses.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3, IVec3};

use super::chunk::packed;
use super::*;
use crate::chunk::ChunkError;
use crate::chunk::container::Container;
use crate::content::PatchKey;
use crate::harmonics::relight_direction;

/// Side of voxels of level 0, and of texels: a patch's cell is half as wide as a voxel of its level.
const VOXEL_M: f64 = 0.1;
const TEXEL_M: f64 = VOXEL_M / 2.0;

/// A point of a surface, and its normal.
type Point = (DVec3, DVec3);

/// Sums over an element's points.
#[derive(Default)]
struct Sum {
    bits: u64,
    points: f64,
    point: DVec3,
    normal: DVec3,
}

/// The patch of a level whose texel has the point: lattices of texels lie across the main axis of the normal.
fn patch_of(level: u32, (point, normal): Point) -> PatchKey {
    let axis = normal.abs().max_position();
    let mut middle = ((point / TEXEL_M).floor() + 0.5) * TEXEL_M;
    middle[axis] = point[axis];
    let apart = normal.dot(middle - point);
    middle[axis] -= apart / normal[axis];
    let cell = (middle / (TEXEL_M * f64::from(1 << level))).floor().as_ivec3();
    let direction = 2 * axis as u8 + u8::from(normal[axis] < 0.0);
    PatchKey::of_cell(level, cell.to_array(), direction, 0)
}

/// Elements of surfaces at three levels, from points that are dense on them; those whose normal `is_dark` says have no patch.
fn surfaces(points: &[Point], is_dark: impl Fn(DVec3) -> bool) -> VoxelPart {
    let mut bricks = Vec::new();
    for level in (0..3).rev() {
        let side_m = VOXEL_M * f64::from(1 << level);
        let mut sums: BTreeMap<(BrickKey, u16), BTreeMap<Option<PatchKey>, Sum>> = BTreeMap::new();
        for &(point, normal) in points {
            let sub = (4.0 * point / side_m).floor().as_ivec3();
            let voxel = sub.map(|at| at.div_euclid(SUBS));
            let patch = (!is_dark(normal)).then(|| patch_of(level, (point, normal)));
            let place = (BrickKey::of_voxel(level, voxel), place_in_brick(voxel));
            let sum = sums.entry(place).or_default().entry(patch).or_default();
            sum.bits |= 1 << sub_in_voxel(sub);
            sum.points += 1.0;
            sum.point += point;
            sum.normal += normal;
        }
        for ((key, place), elements) in sums {
            if bricks.last().is_none_or(|brick: &Brick| brick.key != key) {
                bricks.push(Brick { key, voxels: Vec::new(), elements: Vec::new() });
            }
            let brick = bricks.last_mut().unwrap();
            let middle = (key.first_voxel() + voxel_in_brick(place)).as_dvec3() + 0.5;
            brick.voxels.push(Voxel { place, elements: elements.len() as u16 });
            brick.elements.extend(elements.iter().map(|(&patch, sum)| {
                let normal = NormalCode::of(sum.normal.normalize());
                let height_m =
                    normal.normal().as_dvec3().normalize().dot(sum.point / sum.points - side_m * middle);
                Element {
                    normal,
                    plane: Element::plane_code(height_m, side_m),
                    bits: sum.bits,
                    patch,
                    glow: 0,
                    is_backed: patch.is_some(),
                    is_finest: level == 0,
                }
            }));
        }
    }
    VoxelPart { voxel_m: VOXEL_M as f32, glows: Vec::new(), bricks }
}

/// Points of a square of so many voxels, turned.
fn square(voxels: usize, corner: DVec3, turn: DMat3) -> Vec<Point> {
    let count = 20 * voxels;
    let at = |index: usize| (index as f64 + 0.37) * VOXEL_M / 20.0;
    let place = |index: usize| corner + turn * DVec3::new(at(index % count), at(index / count), 0.0);
    (0..count * count).map(|index| (place(index), turn * DVec3::Z)).collect()
}

/// Turned about no axis in particular.
fn odd() -> DMat3 {
    DMat3::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), 0.7)
}

/// Both sides of a wall of 2 cm.
fn both_sides(turn: DMat3) -> VoxelPart {
    let corner = DVec3::new(-0.4, 0.2, 0.53);
    let front = square(16, corner, turn);
    let back = front.iter().map(|&(point, normal)| (point - 0.02 * normal, -normal));
    let all: Vec<Point> = front.iter().copied().chain(back).collect();
    let n = turn * DVec3::Z;
    surfaces(&all, |normal| normal.dot(n) < 0.0)
}

fn ball(radius_m: f64, points: u32) -> VoxelPart {
    let point = |index: u32| {
        let normal = relight_direction(index, points).as_dvec3();
        (DVec3::new(0.01, 0.03, -0.02) + radius_m * normal, normal)
    };
    surfaces(&(0..points).map(point).collect::<Vec<_>>(), |_| false)
}

/// A ball about the corner of eight bricks.
fn small() -> VoxelPart {
    ball(0.2, 1 << 12)
}

/// Turned boxes of 40 cm, side by side.
fn boxes(count: u32) -> VoxelPart {
    let quarter = 0.5 * std::f64::consts::PI;
    let sides = [0.0, 1.0, 2.0, 3.0].map(|turns| DMat3::from_rotation_x(turns * quarter));
    let ends = [-1.0, 1.0].map(|turns| DMat3::from_rotation_y(turns * quarter));
    let of_box = |index: u32| {
        let toward = relight_direction(index, 32).as_dvec3();
        let middle = 1.5 * DVec3::new(toward.y, 0.3 * toward.z, toward.x);
        let turn = DMat3::from_axis_angle(toward, 0.3 * f64::from(index));
        sides.into_iter().chain(ends).flat_map(move |side| {
            let turn = turn * side;
            square(4, middle + turn * DVec3::new(-0.2, -0.2, 0.2), turn)
        })
    };
    surfaces(&(0..count).flat_map(of_box).collect::<Vec<_>>(), |_| false)
}

/// Bytes an element, told with those of each section.
fn bytes_an_element(name: &str, part: &VoxelPart) -> f64 {
    let bytes = encode_voxels(part).unwrap();
    assert_eq!(&decode_voxels(&bytes).unwrap(), part);
    let container = Container::whole(VOXELS_CHUNK, &bytes).unwrap();
    let elements = part.elements() as f64;
    let mut by_tag: BTreeMap<u8, usize> = BTreeMap::new();
    for (index, entry) in container.entries.iter().enumerate() {
        *by_tag.entry(entry.id.tag).or_default() += container.stored(index).unwrap().len();
    }
    let of_section = |(tag, name): &(u8, &str)| format!("{name} {:.2}", by_tag[tag] as f64 / elements);
    let sections: Vec<String> = ROW.sections.iter().map(of_section).collect();
    let each = bytes.len() as f64 / elements;
    println!("{name}: {elements} elements, {each:.2} bytes each: {}", sections.join(", "));
    each
}

#[test]
fn walls_take_a_byte_an_element_and_curved_surfaces_eight() {
    let floor = surfaces(&square(20, DVec3::new(-1.6, -0.8, 0.93), DMat3::IDENTITY), |_| false);
    assert!(bytes_an_element("floor", &floor) < 0.5);
    assert!(bytes_an_element("wall", &both_sides(DMat3::from_rotation_y(0.5 * std::f64::consts::PI))) < 1.0);
    assert!(bytes_an_element("slanted wall", &both_sides(odd())) < 2.0);
    assert!(bytes_an_element("turned boxes", &boxes(12)) < 2.5);
    assert!(bytes_an_element("ball of 60 cm", &ball(0.6, 1 << 17)) < 8.0);
    assert!(bytes_an_element("ball of 20 cm", &ball(0.2, 1 << 14)) < 10.0);
}

#[test]
fn a_prefix_of_any_length_has_the_coarsest_levels_in_it_or_is_an_error() {
    let part = both_sides(odd());
    let bytes = encode_voxels(&part).unwrap();
    let total = bytes.len() as u64;
    let layers = voxel_layers(&bytes[..600], total).unwrap();
    assert_eq!(layers.iter().map(|layer| layer.level).collect::<Vec<_>>(), [2, 1, 0]);
    assert_eq!(layers.last().map(|layer| layer.bytes), Some(total));
    for length in (0..bytes.len()).step_by(7).chain([bytes.len()]) {
        let largest = layers.iter().rev().find(|layer| layer.bytes <= length as u64);
        match decode_voxels_prefix(&bytes[..length], total) {
            Ok((found, layer)) => {
                assert_eq!(Some(&layer), largest);
                let is_in = |brick: &&Brick| brick.key.level >= layer.level;
                let wanted: Vec<Brick> = part.bricks.iter().filter(is_in).cloned().collect();
                assert_eq!(found, VoxelPart { bricks: wanted, ..part.clone() });
            }
            Err(error) => assert!(largest.is_none(), "{length}: {error}"),
        }
    }
}

#[test]
fn a_part_without_bricks_is_a_chunk_too() {
    let part = VoxelPart { bricks: Vec::new(), ..small() };
    let bytes = encode_voxels(&part).unwrap();
    assert_eq!(decode_voxels(&bytes).unwrap(), part);
    assert_eq!(voxel_layers(&bytes, bytes.len() as u64).unwrap().len(), 1);
}

/// A part changed against a rule: told by the encoder, and by the decoder of what an encoder without rules makes of it.
fn refused(change: fn(&mut VoxelPart)) -> [String; 2] {
    let mut part = small();
    part.glows.push(Glow { emitter: 7, share: [1.0, 0.5, 0.25] });
    change(&mut part);
    let told = |result: Result<(), ChunkError>| result.unwrap_err().to_string();
    [
        told(encode_voxels(&part).map(drop)),
        told(packed(&part).and_then(|bytes| decode_voxels(&bytes)).map(drop)),
    ]
}

fn assert_refused(change: fn(&mut VoxelPart), words: &str) {
    for told in refused(change) {
        assert!(told.contains(words), "{told}, wanted {words}");
    }
}

#[test]
fn parts_out_of_order_are_refused() {
    assert_refused(|part| part.bricks.reverse(), "does not ascend");
    assert_refused(
        |part| {
            let count = part.bricks.len();
            part.bricks.swap(count - 1, count - 2);
        },
        "brick",
    );
    assert_refused(|part| part.bricks.insert(1, part.bricks[0].clone()), "brick");
    let mut part = small();
    part.bricks.last_mut().unwrap().voxels.swap(0, 1);
    assert!(encode_voxels(&part).unwrap_err().to_string().contains("voxel number 1 does not ascend"));
}

#[test]
fn voxels_and_elements_that_hold_nothing_are_refused() {
    assert_refused(|part| part.bricks[0].elements[0].bits = 0, "bits of an element");
    assert_refused(
        |part| {
            part.bricks[0].voxels.clear();
            part.bricks[0].elements.clear();
        },
        "voxels",
    );
    let refused = |change: fn(&mut Brick)| {
        let mut part = small();
        change(part.bricks.last_mut().unwrap());
        encode_voxels(&part).unwrap_err().to_string()
    };
    assert!(refused(|brick| brick.voxels[0].elements = 0).contains("elements of a voxel"));
    assert!(refused(|brick| _ = brick.elements.pop()).contains("elements of a brick"));
    assert!(refused(|brick| brick.voxels[0].place = 512).contains("does not ascend"));
}

#[test]
fn values_out_of_range_are_refused() {
    assert_refused(|part| part.bricks[1].elements[0].glow = 2, "glow");
    assert_refused(|part| part.voxel_m = 0.0, "side of a voxel");
    assert_refused(|part| part.voxel_m = f32::NAN, "side of a voxel");
    assert_refused(|part| part.glows[0].share[1] = f32::INFINITY, "share");
    assert_refused(|part| part.glows[0].share[1] = -1.0, "share");
    assert_refused(
        |part| {
            let brick = &mut part.bricks[0];
            brick.key = BrickKey::new(LEVELS_MAX, brick.key.cell());
        },
        "level",
    );
    assert_refused(|part| part.bricks[0].key = BrickKey::new(2, IVec3::new(0, 0, -BRICKS_MAX - 1)), "cell");
    assert_refused(|part| part.bricks[0].elements[0].normal.0[1] = i16::MIN, "normal");
}

#[test]
fn keys_of_the_sky_and_of_differences_are_refused() {
    for (key, words) in [
        (PatchKey::of_sky(3), "level in a patch's key"),
        (PatchKey::of_cell(1, [0; 3], 2, 0).difference(), "direction in a patch's key"),
    ] {
        let mut part = small();
        part.bricks[0].elements[0].patch = Some(key);
        let told = encode_voxels(&part).unwrap_err().to_string();
        assert!(told.contains(words), "{told}");
    }
}
