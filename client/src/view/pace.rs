//! Turns of light that comes piece by piece: to fetch more of what a view needs, to hear of more, to rest.

use crate::preview::View;
use crate::stream::Streamed;

/// Longest wait for clusters to land, where no other view could want others of those that have.
const LISTEN_SECS: u32 = 5;
/// Growth of a step that was too small for one view and meets another. More → fewer looks in vain, and larger pieces.
const GROWTH: u64 = 4;

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
    /// Step of the next look at another view than the one that was missed.
    step: u64,
    /// View and memory for which a step brought nothing: it is too small for any layer, or all that is known of is there.
    missed: Option<(View, u64)>,
    /// View and memory for which all that is known of has been looked at in vain.
    served: Option<(View, u64)>,
}

impl Pace {
    /// Turns of steps of so many bytes, more where no layer fits into one.
    pub fn new(step_min: u64) -> Self {
        Self { step_min, step: step_min, missed: None, served: None }
    }

    /// The next thing to do for a view and a memory, of the light that is there. Hearing `is_due` where it was long ago: a view that
    /// moves all the time is never served, and must not put it off.
    pub fn turn(&self, wanted: &(View, u64), there: &Streamed, is_due: bool) -> Turn {
        let has_all_known = there.whole == there.clusters_all && there.rest == 0 && there.memory <= wanted.1;
        let is_served = has_all_known || self.served.as_ref() == Some(wanted);
        match (is_served, there.baked) {
            (false, Some(_)) if is_due => Turn::Hear { wait_secs: 0 },
            // Without a step one more look tells whether it was too small.
            (false, _) if self.missed.as_ref() == Some(wanted) => Turn::Refine { step: u64::MAX },
            (false, _) => Turn::Refine { step: self.step },
            (true, None) => Turn::Rest,
            // Where others of those that have landed are to be had, another view is not kept waiting for them.
            (true, Some(_)) => Turn::Hear { wait_secs: if has_all_known { LISTEN_SECS } else { 0 } },
        }
    }

    /// A view and a memory were refined for.
    pub fn refined(&mut self, wanted: &(View, u64), has_brought_any: bool) {
        if has_brought_any {
            // Layers that came for this view may have taken the room of those that came for the one that was served.
            self.restart();
        } else if self.missed.as_ref() == Some(wanted) {
            // Memory holds no more, or the rest is lost: what it holds is that which another view needs.
            self.restart();
            self.served = Some(wanted.clone());
        } else {
            (self.step, self.missed) = (self.step.saturating_mul(GROWTH), Some(wanted.clone()));
        }
    }

    /// It was listened.
    pub fn heard(&mut self, has_more: bool) {
        if has_more {
            self.restart();
        }
    }

    fn restart(&mut self) {
        (self.step, self.missed, self.served) = (self.step_min, None, None);
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
            assert_eq!(pace.turn(&wanted, &there, false), Turn::Refine { step });
            pace.refined(&wanted, false);
        }
        for _ in 0..3 {
            assert_eq!(pace.turn(&wanted, &there, false), Turn::Hear { wait_secs: 0 });
            pace.heard(false);
        }
        // Of a bake that is done nothing is to be heard.
        assert_eq!(pace.turn(&wanted, &Streamed { baked: None, ..there }, false), Turn::Rest);
        let mut other = view;
        std::mem::swap(&mut other.camera.eye_m, &mut other.camera.target_m);
        for other in [(other, 10), (wanted.0.clone(), 11)] {
            assert_eq!(pace.turn(&other, &there, false), Turn::Refine { step: 5 });
        }
        pace.heard(true);
        assert_eq!(pace.turn(&wanted, &there, false), Turn::Refine { step: 5 });
        pace.refined(&wanted, true);
        assert_eq!(pace.turn(&wanted, &there, false), Turn::Refine { step: 5 });
        // With all that has landed, the next is waited for.
        let all = Streamed { whole: 3, ..there };
        assert_eq!(pace.turn(&wanted, &all, false), Turn::Hear { wait_secs: LISTEN_SECS });
    }
    /// Views that differ, and light that is there in part.
    fn views() -> ([(View, u64); 3], Streamed) {
        let (_, view) = fixture_view();
        let wanted = [1.0, 2.0, 3.0].map(|x| {
            let mut other = view.clone();
            other.camera.eye_m[0] += x;
            (other, 10)
        });
        let baked = Some(Default::default());
        (wanted, Streamed { whole: 1, clusters_all: 3, memory: 10, baked, ..Streamed::default() })
    }

    #[test]
    fn hearing_that_is_due_waits_for_no_view_to_rest() {
        let (wanted, there) = views();
        let mut pace = Pace::new(5);
        for (view, is_due) in wanted.iter().zip([false, false, true]) {
            let turn = pace.turn(view, &there, is_due);
            assert_eq!(turn == Turn::Hear { wait_secs: 0 }, is_due, "{turn:?}");
            pace.refined(view, false);
        }
        // Of a bake that is done nothing is to be heard.
        let turn = pace.turn(&wanted[0], &Streamed { baked: None, ..there }, true);
        assert!(matches!(turn, Turn::Refine { .. }), "{turn:?}");
    }

    #[test]
    fn step_that_was_too_small_for_one_view_grows_for_another_and_is_unbound_for_the_same() {
        let ([a, b, c], there) = views();
        let mut pace = Pace::new(5);
        pace.refined(&a, false);
        assert_eq!(pace.turn(&a, &there, false), Turn::Refine { step: u64::MAX });
        assert_eq!(pace.turn(&b, &there, false), Turn::Refine { step: 20 });
        pace.refined(&b, false);
        assert_eq!(pace.turn(&c, &there, false), Turn::Refine { step: 80 });
        pace.refined(&c, true);
        assert_eq!(pace.turn(&c, &there, false), Turn::Refine { step: 5 });
    }

    #[test]
    fn view_that_was_served_is_looked_at_again_once_layers_came_for_another() {
        let ([a, b, _], there) = views();
        let there = Streamed { baked: None, ..there };
        let mut pace = Pace::new(5);
        pace.refined(&a, false);
        pace.refined(&a, false);
        assert_eq!(pace.turn(&a, &there, false), Turn::Rest);
        pace.refined(&b, true);
        assert_eq!(pace.turn(&a, &there, false), Turn::Refine { step: 5 });
    }
}
