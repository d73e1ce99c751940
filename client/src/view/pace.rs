//! Turns of light that comes piece by piece: to fetch more of what a view needs, to hear of more, to rest.

use crate::preview::View;
use crate::stream::Streamed;

/// Longest wait for clusters to land, where no other view could want others of those that have.
const LISTEN_SECS: u32 = 5;

/// The next thing to do for light that comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Nothing, until another view or memory is wanted.
    Rest,
    /// To hear of what has landed, with so long a wait.
    Hear { wait_secs: u32 },
    /// To fetch what is needed most, of so many bytes.
    Refine { step: u64 },
}

/// Turns of light that comes: the view is looked at again only where it is another, or where something has landed since.
pub struct Pace {
    step_min: u64,
    step: u64,
    /// View and memory for which all that is known of has been looked at in vain.
    served: Option<(View, u64)>,
}

impl Pace {
    /// Turns of steps of so many bytes, more where no layer fits into one.
    pub fn new(step_min: u64) -> Self {
        Self { step_min, step: step_min, served: None }
    }

    /// The next thing to do for a view and a memory, of the light that is there.
    pub fn turn(&self, wanted: &(View, u64), there: &Streamed) -> Turn {
        let has_all_known = there.whole == there.clusters_all && there.memory <= wanted.1;
        let is_served = has_all_known || self.served.as_ref() == Some(wanted);
        match (is_served, there.baked) {
            (false, _) => Turn::Refine { step: self.step },
            (true, None) => Turn::Rest,
            // Where others of those that have landed are to be had, another view is not kept waiting for them.
            (true, Some(_)) => Turn::Hear { wait_secs: if has_all_known { LISTEN_SECS } else { 0 } },
        }
    }

    /// A view and a memory were refined for.
    pub fn refined(&mut self, wanted: &(View, u64), has_brought_any: bool) {
        if has_brought_any {
            self.step = self.step_min;
        } else if self.step < u64::MAX {
            // The step is too small for any layer, or memory is full: without a step one more look tells which.
            self.step = u64::MAX;
        } else {
            // Memory holds no more, or the rest is lost: what it holds is that which another view needs.
            (self.step, self.served) = (self.step_min, Some(wanted.clone()));
        }
    }

    /// It was listened.
    pub fn heard(&mut self, has_more: bool) {
        if has_more {
            (self.step, self.served) = (self.step_min, None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::fixture_view;

    #[test]
    fn view_is_looked_at_anew_only_where_it_is_another_or_where_something_has_landed() {
        let (_, view) = fixture_view();
        let wanted = (view.clone(), 10);
        let there = Streamed {
            whole: 1,
            clusters_all: 3,
            memory: 10,
            baked: Some(Default::default()),
            ..Streamed::default()
        };
        let mut pace = Pace::new(5);
        for step in [5, u64::MAX] {
            assert_eq!(pace.turn(&wanted, &there), Turn::Refine { step });
            pace.refined(&wanted, false);
        }
        for _ in 0..3 {
            assert_eq!(pace.turn(&wanted, &there), Turn::Hear { wait_secs: 0 });
            pace.heard(false);
        }
        // Of a bake that is done nothing is to be heard.
        assert_eq!(pace.turn(&wanted, &Streamed { baked: None, ..there }), Turn::Rest);
        let mut other = view;
        std::mem::swap(&mut other.camera.eye_m, &mut other.camera.target_m);
        for other in [(other, 10), (wanted.0.clone(), 11)] {
            assert_eq!(pace.turn(&other, &there), Turn::Refine { step: 5 });
        }
        pace.heard(true);
        assert_eq!(pace.turn(&wanted, &there), Turn::Refine { step: 5 });
        pace.refined(&wanted, true);
        assert_eq!(pace.turn(&wanted, &there), Turn::Refine { step: 5 });
        // With all that has landed, the next is waited for.
        let all = Streamed { whole: 3, ..there };
        assert_eq!(pace.turn(&wanted, &all), Turn::Hear { wait_secs: LISTEN_SECS });
    }
}
