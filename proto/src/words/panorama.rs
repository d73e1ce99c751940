//! Panoramas as skies: a file, its turn and strength.

use super::{Words, WordsError};

const PANORAMA: &str = "FILE [turn=degrees] [strength=s]";
/// Keys of the words.
const KEYS: [&str; 2] = ["turn", "strength"];
/// Farthest turn either way, in degrees.
const TURN_MAX_DEG: f32 = 3600.0;

/// A file, its turn in degrees about the vertical and the factor on its radiance: `FILE turn=90 strength=2`. The file's name may have
/// spaces.
pub fn panorama_from_text(text: &str) -> Result<(String, [f32; 2]), WordsError> {
    let is_word = |word: &str| word.split_once('=').is_some_and(|(key, _)| KEYS.contains(&key));
    let mut file = text.trim();
    let mut rest = Vec::new();
    while let Some((before, word)) = file.rsplit_once(char::is_whitespace).filter(|(_, word)| is_word(word)) {
        rest.push(word);
        file = before.trim_end();
    }
    if file.is_empty() || is_word(file) {
        let problem = format!("'{text:.200}' begins with no file");
        return Err(WordsError { problem, grammar: PANORAMA });
    }
    let mut words = Words::from_text(rest.into_iter().rev(), PANORAMA)?;
    let turn_deg = words.number(&["turn"], -TURN_MAX_DEG, TURN_MAX_DEG)?.unwrap_or(0.0);
    let strength = words.number(&["strength"], 0.0, f32::MAX)?.unwrap_or(1.0);
    words.end()?;
    Ok((file.to_owned(), [turn_deg, strength]))
}

/// Words that [`panorama_from_text`] reads as that, without those that change nothing.
pub fn panorama_to_text(file: &str, [turn_deg, strength]: [f32; 2]) -> String {
    let mut text = file.to_owned();
    if turn_deg != 0.0 {
        text += &format!(" turn={turn_deg}");
    }
    if strength != 1.0 {
        text += &format!(" strength={strength}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panoramas_are_a_file_with_a_turn_and_a_strength() {
        for (text, file, numbers) in [
            ("a.hdr", "a.hdr", [0.0, 1.0]),
            ("my skies/a = b.hdr turn=-90.5 strength=2", "my skies/a = b.hdr", [-90.5, 2.0]),
            ("a.hdr strength=0", "a.hdr", [0.0, 0.0]),
        ] {
            assert_eq!(panorama_from_text(text), Ok((file.to_owned(), numbers)), "{text}");
            assert_eq!(panorama_to_text(file, numbers), text);
        }
        for (text, wanted) in [
            ("", "begins with no file"),
            ("turn=3", "begins with no file"),
            ("a.hdr turn=nan", "not finite"),
            ("a.hdr turn=1 turn=2", "given twice"),
            ("a.hdr strength=-1", "strength=-1"),
        ] {
            let error = panorama_from_text(text).unwrap_err().to_string();
            assert!(error.contains(wanted), "{text}: {error}");
        }
    }
}
