use glam::{DMat3, DVec3};

use super::super::content::{BrickKey, REGION_LEVELS, voxel_in_brick};
use super::super::shells::{Facet, Random, Scene, box_shell, odd_turn, sheet, sphere_shell};
use super::*;

/// Side of voxels of level 0 in tests.
const H: f64 = 0.0625;
/// Levels of scenes.
const LEVELS: std::ops::Range<u32> = 0..7;

/// Closed shells, five and twenty voxels wide from the middle.
fn shells() -> Vec<(&'static str, Vec<Facet>)> {
    let half = DVec3::new(5.0, 7.3, 4.1) * H;
    vec![
        ("box", box_shell(half, DMat3::IDENTITY)),
        ("box on the lattice", box_shell(DVec3::splat(8.0) * H, DMat3::IDENTITY)),
        ("turned box", box_shell(half, odd_turn())),
        ("sphere of 5 voxels", sphere_shell(5.0 * H, 3)),
        ("sphere of 20 voxels", sphere_shell(20.0 * H, 4)),
    ]
}

/// A start inside a shell about the origin: in free space, or on one of its facets, and a direction into the shell.
fn inside(facets: &[Facet], random: &mut Random) -> (Start, Vec3) {
    let facet = &facets[(random.next() * facets.len() as f32) as usize];
    let (point, normal, direction) = (facet.point(random), facet.normal().as_vec3(), random.direction());
    if random.next() < 0.5 {
        return (Start::free(point * (0.97 * random.next())), direction);
    }
    let up = direction.dot(normal);
    (Start::on(point, normal), if up < 0.0 { direction - normal * (2.0 * up) } else { direction })
}

fn escapes(table: &VoxelTable, facets: &[Facet], walks: u32, tangent: f32) -> u32 {
    let mut random = Random(17);
    let mut count = 0;
    for _ in 0..walks {
        let (start, direction) = inside(facets, &mut random);
        let met = walk(table, &start, direction, tangent);
        count += u32::from(met.is_none_or(|hit| hit.element == NO_ELEMENT));
    }
    count
}

#[test]
fn closed_shells_let_no_walk_out() {
    for (name, facets) in shells() {
        let table = Scene::new(H, LEVELS, &facets).table();
        for tangent in [0.0, 0.05, 0.5, 1.0] {
            assert_eq!(escapes(&table, &facets, 100_000, tangent), 0, "{name}, {tangent}");
        }
    }
}

#[test]
fn closed_shells_of_coarse_and_fine_texels_let_no_walk_out() {
    let mut facets = box_shell(DVec3::new(5.0, 7.3, 9.1) * H, odd_turn());
    facets.iter_mut().for_each(|facet| facet.finest = [0, 2, 1, 3, 0, 1][facet.surface as usize]);
    let mut table = Scene::new(H, LEVELS, &facets).table();
    assert_eq!(table.finest, 0b1110);
    for tangent in [0.0, 0.05, 0.5, 1.0] {
        assert_eq!(escapes(&table, &facets, 50_000, tangent), 0, "{tangent}");
    }
    // Each finest level has to be walked along.
    table.finest = 0b1010;
    assert!(escapes(&table, &facets, 50_000, 0.5) > 100);
}

/// Whether a brick's region is one of every other; bricks of a region come together.
fn is_of_odd_region(key: BrickKey) -> bool {
    let region = key.cell() >> (REGION_LEVELS - 1).saturating_sub(key.level);
    region.element_sum() & 1 == 1
}

#[test]
fn closed_shells_let_no_walk_out_while_finer_bricks_are_missing() {
    let facets = box_shell(DVec3::new(15.0, 17.3, 21.0) * H, odd_turn());
    let scene = Scene::new(H, LEVELS, &facets);
    let missing: [fn(BrickKey) -> bool; 4] = [
        |key| key.level >= REGION_LEVELS || is_of_odd_region(key),
        |key| key.level > 0 || is_of_odd_region(key),
        |key| key.level >= REGION_LEVELS,
        |key| key.level < REGION_LEVELS,
    ];
    for (case, is_there) in missing.into_iter().enumerate() {
        let table = scene.table_of(is_there);
        assert!(table.len() < scene.part.bricks.len());
        for tangent in [0.0, 0.5] {
            assert_eq!(escapes(&table, &facets, 20_000, tangent), 0, "case {case}, {tangent}");
        }
    }
    // Where coarser bricks are missing too, walks do escape.
    let table = scene.table_of(is_of_odd_region);
    assert!(escapes(&table, &facets, 20_000, 0.0) > 100);
}

/// A walk that looks at points a tick apart only, so that it cuts corners.
fn walk_by_samples(table: &VoxelTable, start: &Start, direction: Vec3) -> bool {
    let tick_m = table.voxel_m * 0.25;
    let line = Line::new(start, direction, table.voxel_m);
    (0..1000).any(|step| {
        let tick = ((line.from_m + direction * (step as f32 * tick_m)) / tick_m).floor().as_ivec3();
        let brick = table.brick(0, tick >> BRICK_SIZE);
        let voxel = brick.and_then(|brick| table.voxel(brick, place_in_brick(tick >> VOXEL_SIZE)));
        let middle_m = ((tick >> VOXEL_SIZE).as_vec3() + 0.5) * table.voxel_m;
        voxel.is_some_and(|voxel| {
            let of = table.first_elements[voxel as usize]..table.first_elements[voxel as usize + 1];
            of.map(|number| &table.elements[number as usize]).any(|element| {
                has(element.bits, sub_in_voxel(tick))
                    && line.candidate(element, middle_m, table.voxel_m).is_some()
            })
        })
    })
}

#[test]
fn walks_that_cut_corners_do_leave_closed_shells() {
    let facets = box_shell(DVec3::new(5.0, 7.3, 4.1) * H, odd_turn());
    let table = Scene::new(H, LEVELS, &facets).table();
    let mut random = Random(5);
    let mut count = 0;
    for _ in 0..20_000 {
        let (start, direction) = inside(&facets, &mut random);
        count += u32::from(!walk_by_samples(&table, &start, direction));
    }
    assert!(count > 0);
}

#[test]
fn walks_meet_planes_where_they_are() {
    for turn in [DMat3::IDENTITY, odd_turn()] {
        let facets: Vec<Facet> =
            sheet(turn * DVec3::new(-6.0, -6.0, 0.013), turn * DVec3::X * 12.0, turn * DVec3::Y * 12.0, 0);
        let scene = Scene::new(H, LEVELS, &facets);
        let table = scene.table();
        let normal = facets[0].normal().as_vec3();
        let height = |at: Vec3| (at.as_dvec3() - facets[0].corners[0]).dot(facets[0].normal());
        let mut random = Random(23);
        let (mut count, mut exact, mut sum) = (0, 0, 0.0);
        for _ in 0..20_000 {
            let from_m = turn.as_mat3() * (random.point() + Vec3::new(0.0, 0.0, 1.2));
            let direction = (random.direction() - normal).normalize();
            let tangent = random.next();
            if direction.dot(normal) > -0.5 {
                continue;
            }
            let t_m = (height(from_m) / f64::from(-direction.dot(normal))) as f32;
            let hit = walk(&table, &Start::free(from_m), direction, tangent).unwrap();
            let side_m = table.voxel_m * (1 << scene.level(hit.patch)) as f32;
            let off = (hit.t_m - t_m).abs() * -direction.dot(normal) / side_m;
            // A sub-voxel that the plane touches ends the walk, though it may leave that before it comes to the plane.
            assert!(off < 0.45, "{from_m} {direction} {hit:?}, not {t_m}");
            count += 1;
            sum += off;
            exact += u32::from(off < 0.02);
            // Voxels are up to a quarter of the cone's width.
            assert!(tangent * t_m < 2.0 * table.voxel_m || side_m > 0.2 * tangent * t_m, "{hit:?}");
        }
        assert!(5 * exact > count && sum < 0.1 * count as f32, "{exact} of {count}, {sum}");
    }
}

#[test]
fn own_sheet_is_passed_and_others_are_not() {
    let floor = sheet(DVec3::new(-3.0, -3.0, 0.013), DVec3::X * 6.0, DVec3::Y * 6.0, 0);
    let step = sheet(DVec3::new(1.0, -3.0, 0.013 + H / 8.0), DVec3::X * 2.0, DVec3::Y * 6.0, 1);
    let scene = Scene::new(H, LEVELS, &[floor, step].concat());
    let table = scene.table();
    let at_m = Vec3::new(-0.4, 0.1, 0.013);
    let down = Vec3::new(0.6, 0.8, -1e-3).normalize();
    assert_eq!(walk(&table, &Start::on(at_m, Vec3::Z), down, 0.1), None);
    // The rule is needed: the same start without a normal meets the sheet.
    assert!(walk(&table, &Start::free(at_m + Vec3::Z * 1e-4), down, 0.1).is_some());
    // From above the step, which is within the same voxels.
    let above = Start::free(Vec3::new(1.5, 0.1, 0.5));
    let hit = walk(&table, &above, Vec3::NEG_Z, 0.0).unwrap();
    assert_eq!((scene.surface(hit.patch), hit.is_back), (1, false));
    let beside = Start::on(Vec3::new(0.5, 0.1, 0.013 + 0.2), Vec3::Z);
    let hit = walk(&table, &beside, Vec3::new(0.3, 0.0, -0.9).normalize(), 0.0).unwrap();
    assert_eq!(scene.surface(hit.patch), 0);
}

#[test]
fn thin_walls_are_seen_from_their_own_side_alone() {
    let turn = odd_turn();
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * axis);
    // Thinner than a sub-voxel.
    let thick = z * (H / 16.0);
    let near = sheet(thick - (x + y) * 2.0, x * 4.0, y * 4.0, 0);
    let far = sheet((x + y) * -2.0, y * 4.0, x * 4.0, 1);
    let backed: Vec<Facet> = near.iter().map(|facet| Facet { is_backed: true, ..*facet }).collect();
    let scenes = [&[near.clone(), far].concat(), &backed, &near].map(|facets| Scene::new(H, LEVELS, facets));
    let tables = scenes.each_ref().map(Scene::table);
    let up = z.as_vec3();
    let mut random = Random(31);
    for _ in 0..20_000 {
        let aside = turn.as_mat3() * (random.point() * Vec3::new(1.0, 1.0, 0.0));
        let is_above = random.next() < 0.5;
        let side = if is_above { 1.0 } else { -1.0 };
        let start = Start::free(aside + up * (side * (0.01 + random.next())));
        let direction = (random.direction() * 0.6 - up * side).normalize();
        let tangent = random.next();
        let [two_sided, dark, open] = tables.each_ref().map(|table| walk(table, &start, direction, tangent));
        let hit = two_sided.unwrap();
        assert_eq!((scenes[0].surface(hit.patch), hit.is_back), (u32::from(!is_above), false));
        let hit = dark.unwrap();
        assert_eq!((hit.patch == DARK_PATCH, hit.is_back), (!is_above, !is_above));
        assert_eq!(open.is_some(), is_above);
    }
}

/// How many of 20 000 walks from above end on another surface than the nearest that the line meets, and how many end nowhere.
fn faults(scene: &Scene, table: &VoxelTable, facets: &[Facet], tangent: f32) -> [u32; 2] {
    let mut random = Random(41);
    let mut counts = [0; 2];
    for _ in 0..20_000 {
        let from_m = random.point() * Vec3::new(0.8, 0.8, 0.3) + Vec3::Z;
        let direction = (random.direction() * 0.7 - Vec3::Z).normalize();
        let exact = facets.iter().filter_map(|facet| Some((facet.meets(from_m, direction)?, facet.surface)));
        let (_, surface) = exact.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        match walk(table, &Start::free(from_m), direction, tangent) {
            Some(hit) => counts[0] += u32::from(scene.surface(hit.patch) != surface),
            None => counts[1] += 1,
        }
    }
    counts
}

#[test]
fn borders_of_patches_are_as_sharp_as_the_finest_level() {
    let [left, right] = [(-3.0, 0), (0.37 * H, 1)].map(|(low, surface)| {
        let across = DVec3::X * if surface == 0 { 3.0 + 0.37 * H } else { 3.0 };
        sheet(DVec3::new(low, -3.0, 0.013), across, DVec3::Y * 6.0, surface)
    });
    let facets = [left, right].concat();
    let scene = Scene::new(H, LEVELS, &facets);
    let fine = faults(&scene, &scene.table(), &facets, 1.0);
    let coarse = faults(&scene, &scene.table_of(|key| key.level > 2), &facets, 1.0);
    assert_eq!([fine[1], coarse[1]], [0, 0]);
    assert!(fine[0] < 200 && coarse[0] > 3 * fine[0], "{fine:?} {coarse:?}");
}

#[test]
fn surfaces_of_coarse_texels_are_met_among_finer_ones() {
    let mut facets = sheet(DVec3::new(-4.0, -4.0, 0.013), DVec3::X * 8.0, DVec3::Y * 8.0, 0);
    facets.iter_mut().for_each(|facet| facet.finest = 2);
    let mut random = Random(3);
    for _ in 0..40 {
        let at = random.point().as_dvec3() * DVec3::new(1.5, 1.5, 0.1) + DVec3::Z * 0.15;
        facets.extend(sheet(at, DVec3::X * 0.1, DVec3::Y * 0.1, 1));
    }
    let scene = Scene::new(H, LEVELS, &facets);
    let mut table = scene.table();
    assert_eq!(table.finest, 1 << 2);
    for tangent in [0.0, 0.1, 0.5] {
        let [wrong, none] = faults(&scene, &table, &facets, tangent);
        // Sheets are as much wider than they are as sub-voxels of the cone's width are.
        assert!(none == 0 && wrong < 1200, "{tangent}: {wrong} {none}");
    }
    // The walk of its own is needed.
    table.finest = 0;
    assert!(faults(&scene, &table, &facets, 0.0)[1] > 100);
}

/// The same by all elements of level 0 in turn.
fn walk_by_all(table: &VoxelTable, start: &Start, direction: Vec3) -> Option<WalkHit> {
    let line = Line::new(start, direction, table.voxel_m);
    let pace_m = 0.25 * table.voxel_m / direction;
    let mut best: Option<([f32; 2], Nearest)> = None;
    for (brick, row) in table.bricks.iter().enumerate().filter(|(_, row)| row.level == 0) {
        for place in 0..512 {
            let Some(voxel) = table.voxel(brick as u32, place) else { continue };
            let cell = IVec3::from_array(row.cell) * 8 + voxel_in_brick(place);
            let of = table.first_elements[voxel as usize]..table.first_elements[voxel as usize + 1];
            for number in of {
                let element = &table.elements[number as usize];
                let middle_m = (cell.as_vec3() + 0.5) * table.voxel_m;
                let Some((t_m, is_back)) = line.candidate(element, middle_m, table.voxel_m) else { continue };
                for sub in (0..64).filter(|sub| has(element.bits, *sub)) {
                    let sub = IVec3::new(sub as i32 & 3, sub as i32 >> 2 & 3, sub as i32 >> 4);
                    let low = (cell * 4 + sub).as_vec3() - line.from_m * (4.0 / table.voxel_m);
                    let [a, b] = [low * pace_m, (low + 1.0) * pace_m];
                    let way = [a.min(b).max_element().max(0.0), a.max(b).min_element()];
                    if way[0] >= way[1] || best.is_some_and(|(best, _)| best[0] < way[0]) {
                        continue;
                    }
                    let former = best.filter(|(best, _)| best[0] == way[0]);
                    let mut nearest = former.map_or(Nearest::default(), |(_, nearest)| nearest);
                    let patch = if is_back { DARK_PATCH } else { element.patch_number };
                    nearest.add(WalkHit { element: number, patch, t_m, is_back }, way);
                    best = Some((way, nearest));
                }
            }
        }
    }
    best.and_then(|(_, nearest)| nearest.hit)
}

#[test]
fn walks_meet_the_same_as_a_search_of_all_elements() {
    let mut random = Random(51);
    let mut facets = Vec::new();
    for surface in 0..12 {
        let [at, x, y] = [0; 3].map(|_| random.point().as_dvec3());
        let sheet = sheet(at * 0.6, x * 0.4, y * 0.4, surface);
        facets.extend(sheet.iter().map(|facet| Facet { is_backed: surface & 1 == 0, ..*facet }));
    }
    let table = Scene::new(H, 0..5, &facets).table();
    let (mut others, mut hits) = (0, 0);
    for _ in 0..4000 {
        let (start, direction) = (Start::free(random.point()), random.direction());
        let [found, wanted] = [walk(&table, &start, direction, 0.0), walk_by_all(&table, &start, direction)];
        hits += u32::from(wanted.is_some());
        let is_same = match (found, wanted) {
            (Some(a), Some(b)) => {
                (a.element, a.patch, a.is_back) == (b.element, b.patch, b.is_back)
                    && (a.t_m - b.t_m).abs() < 1e-4
            }
            (a, b) => a == b,
        };
        others += u32::from(!is_same);
    }
    // Ways through corners of sub-voxels are shorter than rounding.
    assert!(hits > 300 && others <= 4, "{others} of {hits}");
}

#[test]
fn walks_outside_all_bricks_see_the_sky_and_come_in_from_there() {
    let facets = sheet(DVec3::new(-1.0, -1.0, 0.013), DVec3::X * 2.0, DVec3::Y * 2.0, 0);
    let table = Scene::new(H, 0..4, &facets).table();
    let far = Start::free(Vec3::new(0.1, 0.2, 300.0));
    let hit = walk(&table, &far, Vec3::NEG_Z, 1e-4).unwrap();
    assert!((hit.t_m - 299.987).abs() < 1e-3, "{hit:?}");
    assert_eq!(walk(&table, &far, Vec3::X, 0.1), None);
    assert_eq!(walk(&table, &far, Vec3::Z, 0.1), None);
    assert_eq!(walk_within(&table, &far, Vec3::NEG_Z, 1e-4, 299.0), None);
    for at_m in [Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e30)] {
        assert_eq!(walk(&table, &Start::free(at_m), Vec3::NEG_Z, 0.1), None);
    }
    assert_eq!(walk(&VoxelTable::default(), &far, Vec3::NEG_Z, 0.1), None);
}

/// The outer side of a box, dark within.
fn solid(half: DVec3, turn: DMat3) -> Vec<Facet> {
    let inner = box_shell(half, turn).into_iter();
    inner
        .map(|facet| Facet {
            corners: [facet.corners[0], facet.corners[2], facet.corners[1]],
            is_backed: true,
            ..facet
        })
        .collect()
}

/// The next face's dark back is in the sub-voxels of an edge, and hides nothing from this one.
#[test]
fn boxes_do_not_hide_the_open_from_their_own_faces() {
    for turn in [DMat3::IDENTITY, odd_turn()] {
        let facets = solid(DVec3::new(5.03, 7.31, 4.17) * H, turn);
        let table = Scene::new(H, LEVELS, &facets).table();
        let mut random = Random(29);
        let mut rim = 0;
        for _ in 0..50_000 {
            let facet = &facets[(random.next() * facets.len() as f32) as usize];
            let (at, normal, direction) =
                (facet.point(&mut random), facet.normal().as_vec3(), random.direction());
            let up = direction.dot(normal);
            let out = if up < 0.0 { direction - normal * (2.0 * up) } else { direction };
            let met = walk(&table, &Start::on(at, normal), out, 0.02 * random.next());
            let Some(hit) = met else { continue };
            assert!(!hit.is_back, "{at} {out}: {hit:?}");
            rim += 1;
        }
        // Starts within a thirtieth of a millimetre of an edge are before both of its faces.
        assert!(rim < 50_000 / 2000, "{rim}");
    }
}

/// Likewise a wall's back, which stands on the start's own sheet, ends walks from its very foot.
#[test]
fn backs_that_stand_on_a_sheet_end_walks_that_start_at_their_foot() {
    for turn in [DMat3::IDENTITY, odd_turn()] {
        for shift in [0.0, 0.11, 0.24] {
            let floor = sheet(
                turn * DVec3::new(-1.0, -1.0, shift * H),
                turn * DVec3::X * 2.0,
                turn * DVec3::Y * 2.0,
                0,
            );
            let mut wall =
                sheet(turn * DVec3::new(0.013, 1.0, shift * H), turn * DVec3::Y * -2.0, turn * DVec3::Z, 1);
            wall.iter_mut().for_each(|facet| facet.is_backed = true);
            let back = wall[0].normal().as_vec3();
            let table = Scene::new(H, LEVELS, &[floor, wall].concat()).table();
            let mut random = Random(31);
            for _ in 0..20_000 {
                let away_m = 0.3 * H as f32 * random.next() + 1e-4;
                let along = (turn * DVec3::new(0.013, f64::from(random.next() - 0.5), shift * H)).as_vec3();
                let start = Start::on(along - back * away_m, (turn * DVec3::Z).as_vec3());
                let up = start.normal.unwrap_or_default();
                let aside = back.cross(up) * (random.next() - 0.5);
                let direction = (back + up * (1.5 * random.next()) + aside).normalize();
                let hit = walk(&table, &start, direction, 0.02);
                assert!(hit.is_some_and(|hit| hit.is_back), "{shift} {direction}: {hit:?}");
            }
        }
    }
}

/// Seconds of all cores; walks that start in free space, and on flat walls. A start on a sphere of five voxels may lie within rounding of its crease,
/// where one in a million gets out.
#[test]
#[ignore = "ten million walks"]
fn ten_million_walks_stay_in_closed_shells() {
    for (name, facets) in shells() {
        let table = Scene::new(H, LEVELS, &facets).table();
        let mut random = Random(41);
        let mut out = 0;
        for index in 0..2_500_000_u32 {
            let (start, direction) = inside(&facets, &mut random);
            let start = if name.starts_with("sphere") { Start { normal: None, ..start } } else { start };
            let start =
                Start { at_m: if start.normal.is_none() { 0.97 * start.at_m } else { start.at_m }, ..start };
            let tangent = [0.0, 0.05, 0.5, 1.0][index as usize % 4];
            let met = walk(&table, &start, direction, tangent);
            out += u32::from(met.is_none_or(|hit| hit.element == NO_ELEMENT));
        }
        assert_eq!(out, 0, "{name}");
    }
}
