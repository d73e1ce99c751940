use glam::DVec3;

use super::super::content::{Voxel, place_in_brick, voxel_in_brick};
use super::super::shells::{Random, Scene, sphere_shell};
use super::*;

fn key(surface: u32) -> PatchKey {
    PatchKey::of_cell(0, [0; 3], 0, surface)
}

fn element(surface: u32) -> Element {
    Element {
        normal: NormalCode::of(DVec3::new(0.6, 0.0, -0.8)),
        plane: Element::plane_code(-0.2, 1.0),
        bits: 1 << 40 | 6,
        patch: (surface > 0).then(|| key(surface)),
        glow: 0,
        is_backed: false,
        is_finest: false,
    }
}

/// A part of one brick with so many elements in each of some voxels.
fn part(level: u32, cell: IVec3, voxels: &[(u16, u16)]) -> VoxelPart {
    let voxels: Vec<Voxel> = voxels.iter().map(|&(place, elements)| Voxel { place, elements }).collect();
    let count = voxels.iter().map(|voxel| u32::from(voxel.elements)).sum();
    let elements = (0..count).map(element).collect();
    VoxelPart {
        voxel_m: 0.25,
        glows: Vec::new(),
        bricks: vec![Brick { key: BrickKey::new(level, cell), voxels, elements }],
    }
}

fn join(parts: &[VoxelPart]) -> Result<VoxelTable, Inconsistent> {
    VoxelTable::join(parts.iter(), |key| Some(100 + key.ordinal()))
}

#[test]
fn elements_are_found_by_level_brick_and_voxel() {
    let mut parts = [
        part(0, IVec3::new(-1, 0, 2), &[(3, 2), (31, 1), (32, 3), (511, 1)]),
        part(2, IVec3::new(-1, 0, 2), &[(0, 1)]),
    ];
    parts[0].glows = vec![Glow { emitter: 1, share: [1.0; 3] }];
    parts[1].glows = vec![Glow { emitter: 4, share: [0.5; 3] }];
    parts[1].bricks[0].elements[0] = Element { glow: 1, is_backed: true, is_finest: true, ..element(0) };
    let table = join(&parts).unwrap();
    assert_eq!((table.len(), table.levels, table.finest, table.top_level()), (2, 0b101, 0b100, 2));
    let brick = table.brick(0, IVec3::new(-1, 0, 2)).unwrap();
    let numbers = |brick, place| {
        let voxel: u32 = table.voxel(brick, place)?;
        Some(table.first_elements[voxel as usize]..table.first_elements[voxel as usize + 1])
    };
    assert_eq!(numbers(brick, 3), Some(0..2));
    assert_eq!([31, 32, 511].map(|place| numbers(brick, place)), [Some(2..3), Some(3..6), Some(6..7)]);
    assert_eq!([0, 30, 33, 510].map(|place| numbers(brick, place)), [None, None, None, None]);
    let row = table.elements[4];
    assert!((row.normal() - Vec3::new(0.6, 0.0, -0.8)).length() < 1e-4);
    assert!((row.height_m + 0.05).abs() < 1e-5);
    assert_eq!((row.bits, row.patch_number, row.glow()), ([6, 1 << 8], 104, None));
    let top =
        table.elements[numbers(table.brick(2, IVec3::new(-1, 0, 2)).unwrap(), 0).unwrap().start as usize];
    assert_eq!(
        (top.patch_number, top.glow(), top.is_backed(), top.is_finest()),
        (DARK_PATCH, Some(1), true, true)
    );
    assert_eq!(table.glows[1].emitter, 4);
    for (level, cell) in [(1, IVec3::new(-1, 0, 2)), (0, IVec3::new(-1, 0, 3)), (2, IVec3::ZERO)] {
        assert_eq!(table.brick(level, cell), None);
    }
}

#[test]
fn bare_eighths_are_those_without_voxels() {
    for place in [0, 7, 60, 200, 300, 511] {
        let table = join(&[part(0, IVec3::ZERO, &[(place, 1)])]).unwrap();
        for eighth in 0..8 {
            let eighth = IVec3::new(eighth & 1, eighth >> 1 & 1, eighth >> 2);
            assert_eq!(table.is_bare(0, eighth), voxel_in_brick(place) / 4 != eighth, "{place} {eighth}");
        }
    }
}

#[test]
fn boxes_around_empty_voxels_are_doubled_as_long_as_they_hold_nothing() {
    for place in [0, 7, 60, 200, 300, 511] {
        let table = join(&[part(0, IVec3::ZERO, &[(place, 1)])]).unwrap();
        for other in (0..512).filter(|other| *other != place) {
            let [held, voxel] = [place, other].map(voxel_in_brick);
            let wanted = if held / 4 != voxel / 4 { 2 } else { u32::from(held / 2 != voxel / 2) };
            assert_eq!(table.bare_around(0, voxel - 8), wanted, "{place} {other}");
        }
    }
}

#[test]
fn all_bricks_and_voxels_of_a_scene_are_found_and_no_others() {
    let scene = Scene::new(0.05, 0..6, &sphere_shell(1.0, 3));
    let table = scene.table();
    let mut random = Random(1);
    for _ in 0..20_000 {
        let level = (random.next() * 6.0) as u32;
        let voxel = (random.point() * (32.0 / (1 << level) as f32)).floor().as_ivec3();
        let key = BrickKey::of_voxel(level, voxel);
        let brick = scene.part.bricks.iter().find(|brick| brick.key == key);
        let found = table.brick(level, key.cell());
        assert_eq!(found.is_some(), brick.is_some());
        let place = place_in_brick(voxel);
        let is_there = brick.is_some_and(|brick| brick.voxels.iter().any(|voxel| voxel.place == place));
        assert_eq!(found.and_then(|brick| table.voxel(brick, place)).is_some(), is_there);
    }
    assert_eq!(table.elements.len(), scene.part.elements());
    assert!(table.slots.len() >= 2 * table.len() && table.holds(IVec3::ZERO));
}

#[test]
fn parts_that_contradict_each_other_are_refused() {
    let one = part(0, IVec3::ZERO, &[(3, 1)]);
    let with = |change: &dyn Fn(&mut VoxelPart)| {
        let mut part = part(0, IVec3::X, &[(3, 1)]);
        change(&mut part);
        join(&[one.clone(), part]).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(with(&|_| {}), Ok(()));
    let problem = |change: &dyn Fn(&mut VoxelPart)| with(change).unwrap_err();
    assert!(problem(&|part| part.voxel_m = 0.5).contains("0.5 m, others of 0.25 m"));
    assert!(problem(&|part| part.bricks[0].key = BrickKey::new(0, IVec3::ZERO)).contains("twice"));
    assert!(problem(&|part| part.bricks[0].key = BrickKey::new(14, IVec3::X)).contains("levels"));
    assert!(problem(&|part| part.bricks[0].key = BrickKey::new(1, IVec3::X << 20)).contains("farther"));
    assert!(problem(&|part| part.bricks[0].voxels[0].place = 512).contains("voxel 512"));
    assert!(problem(&|part| part.bricks[0].voxels[0].elements = 0).contains("of 0 elements"));
    assert!(problem(&|part| part.bricks[0].voxels[0].elements = 2).contains("do not have its 1"));
    assert!(problem(&|part| part.bricks[0].elements[0].glow = 1).contains("glow 1"));
    let unknown = VoxelTable::join([&part(0, IVec3::X, &[(3, 2)])].into_iter(), |_| None);
    assert!(unknown.unwrap_err().to_string().contains("unknown"));
    let none = part(0, IVec3::ZERO, &[]);
    let zero = VoxelPart { voxel_m: 0.0, ..none };
    assert!(join(&[zero]).is_err() && join(&[]).unwrap().is_empty());
}

#[test]
fn patches_are_numbered_by_their_place_in_an_ascending_set() {
    let set = |keys: &[u32]| {
        let patch = |&at: &u32| crate::content::Patch { key: key(at), first_leaf: 0, leaf_count: 0 };
        PatchSet { patches: keys.iter().map(patch).collect(), ..PatchSet::default() }
    };
    let ascending = set(&[2, 5, 9]);
    let number = patch_numbers(&ascending).unwrap();
    assert_eq!([2, 5, 9, 4].map(|at| number(key(at))), [Some(0), Some(1), Some(2), None]);
    assert!(patch_numbers(&set(&[5, 2])).is_err() && patch_numbers(&set(&[2, 2])).is_err());
}
