//! The atrium's stone: floors, walls, arcades, vaults, roof.

use core::f32::consts::FRAC_PI_2;

use glam::{Vec2, Vec3};

use super::super::arch::{self, ArcadeBay};
use super::super::glb::Glb;
use super::super::mesh::Mesh;
use super::super::shapes::{self, Side};
use super::super::{masonry, moulding};
use super::Palette;
use super::plan::{self, *};

/// Outer wall faces, seen from the galleries.
const WALL_X_M: f32 = AXIS_X_M + BAY_M;
const WALL_Z_M: f32 = AXIS_Z_M + BAY_M;
/// The lower and the upper arcade wall; the upper one is thinner.
const LOWER_BAY: ArcadeBay = ArcadeBay {
    width_m: BAY_M,
    height_m: UPPER_FLOOR_M - LOWER_SPRING_M,
    thickness_m: 0.5,
    radius_m: 1.2,
    ring_m: 0.22,
    drop_m: 0.02,
    segments: 16,
};
const UPPER_BAY: ArcadeBay = ArcadeBay {
    height_m: CEILING_M + 0.1 - UPPER_SPRING_M,
    thickness_m: 0.42,
    radius_m: 1.25,
    ring_m: 0.18,
    ..LOWER_BAY
};
const LOWER_RADIUS_M: f32 = 0.25;
const UPPER_RADIUS_M: f32 = 0.205;
const PEDESTAL_M: f32 = 1.02;
/// Repeats per metre of the stone and tile images.
const ASHLAR_SCALE: Vec2 = Vec2::splat(1.0 / 1.5);
const TILE_SCALE: Vec2 = Vec2::splat(0.5);

pub(super) fn build(glb: &mut Glb, palette: &Palette) {
    floors(glb, palette);
    outer_walls(glb, palette);
    arcades(glb, palette);
    vaults(glb, palette);
    roof(glb, palette);
}

fn floors(glb: &mut Glb, palette: &Palette) {
    let edge = Vec3::new(AXIS_X_M - 0.55, 0.0, AXIS_Z_M - 0.55);
    let mut court = Mesh::default();
    court.rectangle(Vec3::new(-edge.x, 0.0, edge.z), Vec3::X * 2.0 * edge.x, Vec3::Z * -2.0 * edge.z);
    glb.object("court floor", &court.with_uv_scale(TILE_SCALE), palette.court_tiles);

    let raised = edge + Vec3::Y * LOWER_FLOOR_M;
    let step = shapes::room(-edge, raised, &[Side::Top, Side::Bottom]);
    glb.object("court step", &step, palette.stone);
    let wall = Vec3::new(WALL_X_M, 0.0, WALL_Z_M);
    let low = Vec3::Y * LOWER_FLOOR_M;
    let lower = shapes::floor_with_hole(low - wall, low + wall, -edge, edge);
    glb.object("lower gallery floor", &lower.with_uv_scale(TILE_SCALE), palette.gallery_tiles);

    let inner = 0.5 * LOWER_BAY.thickness_m;
    let hole = Vec3::new(AXIS_X_M - inner, 0.0, AXIS_Z_M - inner);
    let high = Vec3::Y * UPPER_FLOOR_M;
    let upper = shapes::floor_with_hole(high - wall, high + wall, -hole, hole);
    glb.object("upper gallery floor", &upper.with_uv_scale(TILE_SCALE), palette.gallery_tiles);
    let string_course = moulding::cornice(hole.x, hole.z, UPPER_FLOOR_M - 0.5, UPPER_FLOOR_M, 0.27);
    glb.object("string course", &string_course, palette.stone);
}

fn outer_walls(glb: &mut Glb, palette: &Palette) {
    let min = Vec3::new(-WALL_X_M, LOWER_FLOOR_M, -WALL_Z_M);
    let max = Vec3::new(WALL_X_M, CEILING_M, WALL_Z_M);
    for (name, side) in [
        ("north wall", Side::Back),
        ("south wall", Side::Front),
        ("west wall", Side::Left),
        ("east wall", Side::Right),
    ] {
        let wall = shapes::room_side(min, max, side).with_uv_scale(ASHLAR_SCALE);
        glb.object(name, &wall, palette.ashlar);
    }

    let lower = pilaster(LOWER_SPRING_M - LOWER_FLOOR_M + LOWER_BAY.drop_m);
    let lower = glb.mesh("pilaster", &[(&lower, palette.stone)]);
    let upper = glb.mesh("upper pilaster", &[(&pilaster(CEILING_M + 0.01 - UPPER_FLOOR_M), palette.stone)]);
    for line in plan::cross_lines() {
        let wall = |height_m: f32| line.at(Vec3::new(0.0, height_m, -BAY_M));
        glb.place(&format!("pilaster {}", line.name), lower, wall(LOWER_FLOOR_M), line.yaw_rad);
        glb.place(&format!("upper pilaster {}", line.name), upper, wall(UPPER_FLOOR_M), line.yaw_rad);
    }
}

/// A flat pier on a wall at z = 0, its base and head standing out.
fn pilaster(height_m: f32) -> Mesh {
    let block = |half: f32, depth: f32, bottom: f32, top: f32, omitted: &[Side]| {
        shapes::cuboid(Vec3::new(-half, bottom, 0.0), Vec3::new(half, top, depth), omitted)
    };
    let mut mesh = block(0.29, 0.18, 0.0, 0.26, &[Side::Back, Side::Bottom]);
    mesh.append(&block(0.24, 0.13, 0.25, height_m - 0.17, &[Side::Back, Side::Bottom, Side::Top]));
    mesh.append(&block(0.30, 0.19, height_m - 0.18, height_m, &[Side::Back]));
    mesh
}

fn arcades(glb: &mut Glb, palette: &Palette) {
    let lower = arch::arcade_bay(LOWER_BAY).with_uv_scale(ASHLAR_SCALE);
    let lower = glb.mesh("arch", &[(&lower, palette.ashlar)]);
    let upper = arch::arcade_bay(UPPER_BAY).with_uv_scale(ASHLAR_SCALE);
    let upper = glb.mesh("upper arch", &[(&upper, palette.ashlar)]);
    let rail = glb.mesh("balustrade", &[(&masonry::balustrade(2.5, 0.96), palette.stone)]);
    for bay in plan::bays() {
        let at = |height_m: f32| bay.at(Vec3::Y * height_m);
        glb.place(&format!("arch {}", bay.name), lower, at(LOWER_SPRING_M), bay.yaw_rad);
        glb.place(&format!("upper arch {}", bay.name), upper, at(UPPER_SPRING_M), bay.yaw_rad);
        glb.place(&format!("balustrade {}", bay.name), rail, at(UPPER_FLOOR_M), bay.yaw_rad);
    }

    let column = masonry::column(LOWER_SPRING_M - LOWER_FLOOR_M, LOWER_RADIUS_M, 14);
    let column = glb.mesh("column", &[(&column, palette.stone)]);
    let upper_height_m = UPPER_SPRING_M - UPPER_FLOOR_M - PEDESTAL_M;
    let mut upper = masonry::column(upper_height_m, UPPER_RADIUS_M, 14).translated(Vec3::Y * PEDESTAL_M);
    upper.append(&masonry::pedestal(0.62, 0.62, PEDESTAL_M, 0.04));
    let upper = glb.mesh("upper column", &[(&upper, palette.stone)]);
    for spot in plan::columns() {
        let at = |height_m: f32| spot.at(Vec3::Y * height_m);
        glb.place(&format!("column {}", spot.name), column, at(LOWER_FLOOR_M), spot.yaw_rad);
        glb.place(&format!("upper column {}", spot.name), upper, at(UPPER_FLOOR_M), spot.yaw_rad);
    }

    let lower = corner_pier(LOWER_SPRING_M - LOWER_FLOOR_M, UPPER_FLOOR_M + 0.01 - LOWER_FLOOR_M);
    let lower = glb.mesh("corner pier", &[(&lower, palette.stone)]);
    let upper = corner_pier(UPPER_SPRING_M - UPPER_FLOOR_M, CEILING_M + 0.02 - UPPER_FLOOR_M);
    let upper = glb.mesh("upper corner pier", &[(&upper, palette.stone)]);
    for (name, axis_m) in plan::corners() {
        glb.place(&format!("corner pier {name}"), lower, axis_m + Vec3::Y * LOWER_FLOOR_M, 0.0);
        glb.place(&format!("upper corner pier {name}"), upper, axis_m + Vec3::Y * UPPER_FLOOR_M, 0.0);
    }
}

/// A square pier with a base and an impost at the springing.
fn corner_pier(spring_m: f32, height_m: f32) -> Mesh {
    let block = |half: f32, bottom: f32, top: f32, omitted: &[Side]| {
        shapes::cuboid(Vec3::new(-half, bottom, -half), Vec3::new(half, top, half), omitted)
    };
    let mut mesh = block(0.40, 0.0, 0.26, &[Side::Bottom]);
    mesh.append(&block(0.35, 0.25, height_m, &[Side::Bottom, Side::Top]));
    mesh.append(&block(0.41, spring_m - 0.16, spring_m, &[]));
    mesh
}

fn vaults(glb: &mut Glb, palette: &Palette) {
    let vault = glb.mesh("vault", &[(&arch::groin_vault(0.5 * BAY_M, 16), palette.plaster)]);
    let (columns, rows) = (8, 5);
    for row in 0..rows {
        for column in 0..columns {
            if row == 0 || row == rows - 1 || column == 0 || column == columns - 1 {
                let (x, z) = (BAY_M * (column as f32 - 3.5), BAY_M * (row as f32 - 2.0));
                let name = format!("vault {}-{}", column + 1, row + 1);
                glb.place(&name, vault, Vec3::new(x, LOWER_SPRING_M, z), 0.0);
            }
        }
    }
    let rib = glb.mesh("rib", &[(&arch::rib(0.5 * BAY_M, 0.1, 0.36, 0.01, 16), palette.stone)]);
    for line in plan::cross_lines() {
        let middle = line.at(Vec3::new(0.0, LOWER_SPRING_M, -0.5 * BAY_M));
        glb.place(&format!("rib {}", line.name), rib, middle, line.yaw_rad + FRAC_PI_2);
    }
}

fn roof(glb: &mut Glb, palette: &Palette) {
    let inner = 0.5 * UPPER_BAY.thickness_m;
    let (half_x, half_z) = (AXIS_X_M - inner, AXIS_Z_M - inner);
    let eaves = 0.5;
    let hole = Vec3::new(half_x - eaves, 0.0, half_z - eaves);
    let (low, high) = (
        Vec3::new(-WALL_X_M - 0.3, CEILING_M, -WALL_Z_M - 0.3),
        Vec3::new(WALL_X_M + 0.3, CEILING_M + 0.4, WALL_Z_M + 0.3),
    );
    glb.object("roof", &shapes::frame(low, high, -hole, hole), palette.plaster);
    let cornice = moulding::cornice(half_x, half_z, CEILING_M - 0.5, CEILING_M + 0.05, 0.42);
    glb.object("cornice", &cornice, palette.stone);

    let length = WALL_Z_M - AXIS_Z_M;
    let beam = shapes::cuboid(
        Vec3::new(-0.1, -0.24, -0.5 * length),
        Vec3::new(0.1, 0.01, 0.5 * length),
        &[Side::Top, Side::Back, Side::Front],
    );
    let beam = glb.mesh("beam", &[(&beam, palette.wood)]);
    for (side, sign) in [("north", -1.0), ("south", 1.0)] {
        for i in 0..24 {
            let at = Vec3::new(i as f32 - 11.5, CEILING_M, sign * (AXIS_Z_M + 0.5 * BAY_M));
            glb.place(&format!("beam {side} {}", i + 1), beam, at, 0.0);
        }
    }
    for (side, sign) in [("west", -1.0), ("east", 1.0)] {
        for i in 0..9 {
            let at = Vec3::new(sign * (AXIS_X_M + 0.5 * BAY_M), CEILING_M, i as f32 - 4.0);
            glb.place(&format!("beam {side} {}", i + 1), beam, at, FRAC_PI_2);
        }
    }
}
