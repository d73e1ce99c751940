//! A shelf packer: rectangles of falling height in rows. Constant time for each.

use glam::IVec2;

use super::skyline::round_up_to_phase;

/// Rows filled from left to right, each above the last.
pub(super) struct Shelves {
    border: i32,
    right: i32,
    align: i32,
    /// Where the current row starts, how far it is filled, and how high its pieces reach.
    floor: i32,
    filled: i32,
    top: i32,
}

impl Shelves {
    /// An empty block whose content lies right of and above `border`, and left of `right`.
    pub fn new(border: i32, right: i32, align: i32) -> Self {
        Self { border, right, align, floor: border, filled: border, top: border }
    }

    /// The next place in the row, or in a new one, that keeps the lattice phase.
    pub fn place(&mut self, size: IVec2, phase: IVec2, max_top: i32) -> Option<IVec2> {
        let mut x = round_up_to_phase(self.filled, phase.x, self.align);
        if x + size.x > self.right {
            self.floor = self.top;
            x = round_up_to_phase(self.border, phase.x, self.align);
            self.filled = x;
        }
        let y = round_up_to_phase(self.floor, phase.y, self.align);
        if y + size.y > max_top || x + size.x > self.right {
            return None;
        }
        self.filled = x + size.x;
        self.top = self.top.max(y + size.y);
        Some(IVec2::new(x, y))
    }
}
