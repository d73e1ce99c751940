//! Text for people: words on standard error, results on standard output.
//!
//! Names come out of files and from servers, and a terminal takes some characters as orders (a window's title, a cleared
//! screen, text that runs backwards). Whatever is printed goes through [`printable`].

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::process::exit;

use serde::Serialize;

/// Prints a line on standard error.
macro_rules! say {
    ($($argument:tt)*) => {
        eprintln!("{}", $crate::console::printable(&format!($($argument)*)))
    };
}

/// Prints a line on standard output.
macro_rules! answer {
    ($($argument:tt)*) => {
        $crate::console::put(&format!("{}\n", $crate::console::printable(&format!($($argument)*))))
    };
}

pub(crate) use {answer, say};

/// Writes to standard output. Whoever reads it may have seen enough (`kiln list | head`): the program then ends, in peace.
/// Where it cannot be written for another reason, a full disk for one, the program ends with that error.
pub fn put(text: &str) {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => exit(0),
        Err(error) => {
            eprintln!("error: the result cannot be written to standard output ({error})");
            exit(1)
        }
    }
}

/// Writes a value to standard output, as a line of JSON.
pub fn put_json(value: &impl Serialize) {
    put(&format!("{}\n", serde_json::json!(value)));
}

/// The text with its control characters written out, as `\u{1b}`; line ends and tabs stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_order) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if is_order(character) {
            // Writing to a string cannot fail.
            let _ = write!(shown, "{}", character.escape_unicode());
        } else {
            shown.push(character);
        }
    }
    Cow::Owned(shown)
}

/// A terminal would not show it but do something: control characters, and those that turn the direction of text.
fn is_order(character: char) -> bool {
    let is_layout = matches!(character, '\n' | '\t');
    let turns =
        matches!(character, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || (character.is_control() && !is_layout)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_give_a_terminal_no_orders() {
        assert_eq!(printable("wall\u{1b}]0;owned\u{7}"), "wall\\u{1b}]0;owned\\u{7}");
        assert_eq!(printable("a\u{202e}b\rc"), "a\\u{202e}b\\u{d}c");
        let plain = "Küche · 5 m²\n\tlamp";
        assert!(matches!(printable(plain), Cow::Borrowed(text) if text == plain));
    }
}
