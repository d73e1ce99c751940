//! The name that was meant, for messages about one that nobody knows.

/// Likeness (Jaro-Winkler, 0..=1) from which on two names may be meant for each other.
const LIKE_MIN: f64 = 0.8;

/// The most similar of some names, if one is similar at all; of equally similar ones the first.
pub fn nearest<'a>(given: &str, names: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let given = given.to_lowercase();
    let likeness = |name: &str| strsim::jaro_winkler(&given, &name.to_lowercase());
    let all = names.into_iter().map(|name| (likeness(name), name)).filter(|(like, _)| *like > LIKE_MIN);
    all.reduce(|best, next| if next.0 > best.0 { next } else { best }).map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_of_the_pen_find_the_name_that_was_meant_and_others_none() {
        let names = ["preset", "texel_m", "transport_rays", "emitter_rays", "rank_error"];
        for (given, meant) in [
            ("transportrays", Some("transport_rays")),
            ("Texel", Some("texel_m")),
            ("rank-error", Some("rank_error")),
            ("colour", None),
            ("", None),
        ] {
            assert_eq!(nearest(given, names), meant, "{given}");
        }
    }
}
