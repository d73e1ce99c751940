//! A skyline packer: each rectangle to the lowest place it fits, over what was placed so far.

use glam::IVec2;

/// Least value ≥ `value` with the same remainder as `phase`.
pub(super) fn round_up_to_phase(value: i32, phase: i32, multiple: i32) -> i32 {
    value + (phase - value).rem_euclid(multiple)
}

/// The upper outline of what was placed, left to right.
pub(super) struct Skyline {
    /// (left end, height) of each level stretch.
    steps: Vec<(i32, i32)>,
    right: i32,
    align: i32,
}

impl Skyline {
    /// An empty block whose content lies right of and above `border`, and left of `right`.
    pub fn new(border: i32, right: i32, align: i32) -> Self {
        Self { steps: vec![(border, border)], right, align }
    }

    /// The place with the lowest top, then leftmost, that keeps the lattice phase.
    pub fn lowest_place(&self, size: IVec2, phase: IVec2, max_top: i32) -> Option<IVec2> {
        let mut best: Option<(i32, i32)> = None;
        for (index, &(left, height)) in self.steps.iter().enumerate() {
            let x = round_up_to_phase(left, phase.x, self.align);
            if x + size.x > self.right {
                break;
            }
            if best.is_some_and(|(y, _)| height >= y) {
                continue;
            }
            let span = self.steps[index..].iter().enumerate();
            let under = span.take_while(|(i, step)| *i == 0 || step.0 < x + size.x);
            let floor = under.filter(|(i, _)| self.end(index + i) > x).map(|(_, step)| step.1).max();
            let y = round_up_to_phase(floor?, phase.y, self.align);
            if y + size.y <= max_top && best.is_none_or(|b| (y, x) < b) {
                best = Some((y, x));
            }
        }
        best.map(|(y, x)| IVec2::new(x, y))
    }

    fn end(&self, step: usize) -> i32 {
        self.steps.get(step + 1).map_or(self.right, |next| next.0)
    }

    /// Covers the outline under a placed piece.
    pub fn raise(&mut self, at: IVec2, size: IVec2) {
        let (left, right) = (at.x, at.x + size.x);
        let first = self.steps.partition_point(|step| step.0 < left);
        let last = self.steps.partition_point(|step| step.0 <= right);
        let behind = self.steps[last - 1].1;
        let mut levels = vec![(left, at.y + size.y)];
        if right < self.right {
            levels.push((right, behind));
        }
        self.steps.splice(first..last, levels);
    }
}
