//! Parts of a stage that the rays of a few receivers read, while they do.

use std::cell::RefCell;

use glam::Vec3;

use super::marks::{Name, ascending};
use super::stage::Stage;
use crate::geometry::{OwnBits, Trail};
use crate::lightmap::{Found, World};

/// Receivers that are remembered, a power of two. More → fewer parts noted twice, more to clear for each group.
const REMEMBERED: usize = 8192;

/// Cells, tiles and whether a ray left the scene.
pub struct Reads<'a> {
    world: &'a World,
    stage: &'a Stage,
    /// Cells that were crossed.
    pub trail: Trail<'a>,
    tiles: OwnBits,
    /// Receivers that had a hit at hand of late, each at the last bits of its number: all that any such hit reads is noted.
    at_hand: RefCell<Vec<u32>>,
}

impl<'a> Reads<'a> {
    /// Nothing read yet. Of an empty stage nothing ever is.
    pub fn new(world: &'a World, stage: &'a Stage) -> Self {
        let [tiles, remembered] =
            if stage.grid.is_empty() { [0; 2] } else { [world.tiles.len(), REMEMBERED] };
        Self {
            world,
            stage,
            trail: Trail::new(&stage.grid),
            tiles: OwnBits::new(tiles),
            at_hand: RefCell::new(vec![u32::MAX; remembered]),
        }
    }

    /// Notes all that a hit was looked up in.
    pub fn note_hit(&self, found: &Found, point_m: Vec3) {
        if self.stage.grid.is_empty() {
            return;
        }
        let [low_m, high_m] = match self.world.at_hand(found, point_m) {
            Some(own) => {
                let last = &mut self.at_hand.borrow_mut()[own as usize % REMEMBERED];
                if std::mem::replace(last, own) == own {
                    return;
                }
                self.world.bounds_at_hand(own)
            }
            None => self.world.bounds_of_linking(found, point_m),
        };
        self.trail.mark_box(low_m, high_m);
        if let Some((block, texels)) = self.world.texels_of_linking(found) {
            self.world.tiles.of_box(block, texels).for_each(|tile| self.tiles.add(tile as usize));
        }
    }

    /// Notes everything that is less than `reach_m` from a point along each axis.
    pub fn note_around(&self, point_m: Vec3, reach_m: f32) {
        self.trail.mark_box(point_m - reach_m, point_m + reach_m);
    }

    /// Names of what was read, ascending.
    pub fn into_names(self) -> Vec<Name> {
        let Self { world, stage, trail, tiles, .. } = self;
        if stage.grid.is_empty() {
            return Vec::new();
        }
        let tile = |tile: usize| {
            let (block, place) = world.tiles.place(tile as u32);
            Name::tile(world.lightmap.blocks[block as usize].key, place)
        };
        // Cells come in the order of their names, before all tiles.
        let mut names: Vec<Name> = trail.crossed().map(Name::cell).collect();
        let cells = names.len();
        names.extend(tiles.iter().map(tile));
        names[cells..].sort_unstable();
        names.extend(trail.has_left().then(Name::extent));
        ascending(names)
    }
}
