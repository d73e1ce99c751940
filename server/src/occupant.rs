//! Who has a state folder open, in words.

use std::fmt;

/// Who has a state folder open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Occupant {
    /// A server, by its process id.
    Server(u32),
    /// Bakes, by their process ids where these are known.
    Bakes(Vec<u32>),
    /// Bakes of an older program, whose database would have to be brought up to date under them.
    OlderBakes(Vec<u32>),
    /// Bakes of another machine.
    OtherMachine,
    /// A bake that is taking its seat.
    Starting,
    /// A program that does not say who it is: one from before seats.
    Unknown,
}

impl fmt::Display for Occupant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bakes = |f: &mut fmt::Formatter<'_>, whose: &str, ids: &[u32]| {
            let ids: Vec<String> = ids.iter().map(u32::to_string).collect();
            write!(f, "'kiln bake'{whose} (process {})", ids.join(", "))
        };
        match self {
            Self::Server(id) => write!(f, "'kiln server' (process {id})"),
            Self::Bakes(ids) => bakes(f, "", ids),
            Self::OlderBakes(ids) => bakes(f, " of an older version", ids),
            Self::OtherMachine => f.write_str("'kiln bake' on another machine"),
            Self::Starting => f.write_str("another 'kiln bake' that is starting"),
            Self::Unknown => f.write_str("another kiln"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn occupant_is_named_with_its_process() {
        assert_eq!(Occupant::Server(7).to_string(), "'kiln server' (process 7)");
        assert_eq!(Occupant::Bakes(vec![7, 9]).to_string(), "'kiln bake' (process 7, 9)");
    }
}
