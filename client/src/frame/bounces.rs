//! Bounces since the last change of light, and the changes by them that were heard of.

use crate::passes::change::Answer;

/// Bounces since the last change.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Bounces {
    pub(super) count: u32,
    /// Call of the first of them: answers before it are of other light.
    first_call: u64,
    /// The latest answers, oldest first, no more than tell of a cycle.
    heard: Vec<Answer>,
}

impl Bounces {
    /// One more, whose change that call asks for.
    pub(super) fn add(&mut self, call: u64) {
        if self.count == 0 {
            self.first_call = call;
        }
        self.count += 1;
    }

    /// Takes an answer. In each `cycle` bounces all clusters take part.
    pub(super) fn hear(&mut self, answer: Answer, cycle: u64) {
        if self.count == 0 || answer.call < self.first_call {
            return;
        }
        self.heard.push(answer);
        while self.spanned(1) >= cycle {
            self.heard.remove(0);
        }
    }

    /// The change by the latest bounces that were heard of, as many as a cycle at least; `None` while they are fewer.
    pub(super) fn change(&self, cycle: u64) -> Option<f32> {
        (self.spanned(0) >= cycle).then(|| self.heard.iter().map(|answer| answer.change).sum())
    }

    /// Bounces since the change that answers are of, without the first `left_out` of these. An answer spans those whose own never
    /// came.
    fn spanned(&self, left_out: usize) -> u64 {
        let of = |answer: &Answer| answer.call - answer.since.max(self.first_call - 1);
        self.heard.iter().skip(left_out).map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(since: u64, call: u64, change: f32) -> Answer {
        Answer { call, since, change }
    }

    /// As many bounces as reach `last`, the first of call `first`.
    fn bounces(first: u64, last: u64) -> Bounces {
        let mut bounces = Bounces::default();
        (first..=last).for_each(|call| bounces.add(call));
        bounces
    }

    #[test]
    fn latest_answers_that_tell_of_a_cycle_are_added_up() {
        let mut bounces = bounces(1, 9);
        assert_eq!(bounces.change(4), None);
        let heard = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25].into_iter().zip(0..).map(|(change, since)| {
            bounces.hear(answer(since, since + 1, change), 4);
            bounces.change(4)
        });
        let heard: Vec<Option<f32>> = heard.collect();
        assert_eq!(heard, [None, None, None, Some(15.0), Some(7.5), Some(3.75)]);
    }

    #[test]
    fn calls_without_an_answer_are_told_of_by_the_next() {
        // An adapter so far behind that each second call, in step with the turns of clusters, has no answer.
        let mut bounces = bounces(1, 12);
        for (call, wanted) in [(2, None), (4, Some(2.0)), (6, Some(2.0)), (8, Some(2.0))] {
            bounces.hear(answer(call - 2, call, 1.0), 4);
            assert_eq!(bounces.change(4), wanted, "call {call}");
        }
        // One that spans more than a cycle tells enough by itself.
        bounces.hear(answer(8, 12, 0.5), 4);
        assert_eq!(bounces.change(4), Some(0.5));
    }

    #[test]
    fn answers_of_other_light_count_for_nothing() {
        let mut bounces = bounces(10, 14);
        bounces.hear(answer(8, 9, 1.0), 1);
        assert_eq!(bounces.change(1), None);
        bounces.hear(answer(9, 10, 1.0), 2);
        assert_eq!(bounces.change(2), None);
        // Of the bounces that an answer spans two are of this light.
        let mut bounces = self::bounces(10, 14);
        bounces.hear(answer(7, 11, 1.0), 3);
        assert_eq!(bounces.change(3), None);
        bounces.hear(answer(11, 12, 1.0), 3);
        assert_eq!(bounces.change(3), Some(2.0));
        let mut none = Bounces::default();
        none.hear(answer(0, 1, 0.0), 1);
        assert_eq!(none.change(1), None);
    }
}
