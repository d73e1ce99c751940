//! Which bakes a list is to hold, as `GET /v1/bakes` takes it.

use crate::api::BakeState;

/// Longest text that names are filtered by, in characters: the longest name.
pub const MAX_FILTER_CHARS: usize = 200;

/// Which bakes are listed; all of them unless something is set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BakeFilter {
    /// States that a bake may have; all where there are none.
    pub states: Vec<BakeState>,
    /// Text that a bake's name has in it, whatever the case of ASCII letters.
    pub name: String,
    /// Earliest submission, Unix milliseconds.
    pub since_ms: Option<i64>,
}

impl BakeFilter {
    /// Reads names of states, one or several with commas between them.
    ///
    /// Errs with what is wrong and which states there are.
    pub fn states_of(text: &str) -> Result<Vec<BakeState>, String> {
        let state = |name: &str| {
            BakeState::named(name).ok_or_else(|| {
                let shown: String = name.chars().take(40).collect();
                let known = BakeState::ALL.map(BakeState::name).join(", ");
                format!("'{shown}' is no state of a bake; there are {known}")
            })
        };
        text.split(',').map(state).collect()
    }

    /// The filter's parameters in a URL's query, each with its value as it is, not yet escaped.
    pub fn parameters(&self) -> Vec<(&'static str, String)> {
        let states: Vec<&str> = self.states.iter().map(|state| state.name()).collect();
        let mut parameters = Vec::new();
        if !states.is_empty() {
            parameters.push(("state", states.join(",")));
        }
        if !self.name.is_empty() {
            parameters.push(("name", self.name.clone()));
        }
        parameters.extend(self.since_ms.map(|since_ms| ("since_ms", since_ms.to_string())));
        parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_read_as_they_are_written_and_a_wrong_one_is_named() {
        let states = vec![BakeState::Running, BakeState::Failed];
        let filter = BakeFilter { states: states.clone(), ..BakeFilter::default() };
        let [(name, written)] = &filter.parameters()[..] else { panic!("{filter:?}") };
        assert_eq!((*name, BakeFilter::states_of(written)), ("state", Ok(states)));
        for wrong in ["", "running,", "Running", "running,gone"] {
            let told = BakeFilter::states_of(wrong).unwrap_err();
            assert!(told.contains("is no state") && told.contains("paused"), "{wrong}: {told}");
        }
        assert_eq!(BakeFilter::default().parameters(), []);
    }
}
