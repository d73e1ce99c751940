//! Lights, cameras and stances of objects as people write them: `key=value` words on a command line, or the same keys in a JSON object.

mod camera;
mod light;
mod lod;
mod panorama;
mod stance;

use glam::Vec3;
use serde_json::{Map, Value};
use thiserror::Error;

pub use camera::{camera_from_text, camera_to_text};
pub use light::{LightSpec, light_to_text};
pub use lod::{lod_from_text, lod_to_text};
pub use panorama::{panorama_from_text, panorama_to_text};
pub use stance::{object_from_text, stance_from_text, stance_to_text};

/// Words that are no light and no camera.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{problem}; write \"{grammar}\"")]
pub struct WordsError {
    /// Fault and the word that has it.
    pub problem: String,
    /// Words that would be right.
    pub grammar: &'static str,
}

/// Words by their keys; each is taken once, and a word that is left over is an error.
struct Words {
    grammar: &'static str,
    pairs: Vec<(String, String)>,
}

impl Words {
    /// Splits `key=value` words.
    fn from_text<'a>(
        words: impl Iterator<Item = &'a str>,
        grammar: &'static str,
    ) -> Result<Self, WordsError> {
        let mut this = Self { grammar, pairs: Vec::new() };
        for word in words {
            let Some((key, value)) = word.split_once('=') else {
                return Err(this.wrong(format!("'{word}' is not key=value")));
            };
            if this.pairs.iter().any(|(known, _)| known == key) {
                return Err(this.wrong(format!("'{key}' is given twice")));
            }
            this.pairs.push((key.to_owned(), value.to_owned()));
        }
        Ok(this)
    }

    /// The members of an object: numbers, and lists of numbers.
    fn from_json(object: &Map<String, Value>, grammar: &'static str) -> Result<Self, WordsError> {
        let mut this = Self { grammar, pairs: Vec::new() };
        for (key, value) in object {
            let numbers = value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice);
            if !numbers.iter().all(Value::is_number) {
                return Err(this.wrong(format!("'{key}' is neither a number nor a list of numbers")));
            }
            let texts: Vec<String> = numbers.iter().map(Value::to_string).collect();
            this.pairs.push((key.clone(), texts.join(",")));
        }
        Ok(this)
    }

    fn wrong(&self, problem: impl Into<String>) -> WordsError {
        WordsError { problem: problem.into(), grammar: self.grammar }
    }

    /// Key and value of the word under any of `keys`, which mean the same.
    fn take(&mut self, keys: &[&str]) -> Option<(String, String)> {
        let index = self.pairs.iter().position(|(known, _)| keys.contains(&known.as_str()))?;
        Some(self.pairs.remove(index))
    }

    /// A number in `lowest..=highest`, if given.
    fn number(&mut self, keys: &[&str], lowest: f32, highest: f32) -> Result<Option<f32>, WordsError> {
        let Some((key, text)) = self.take(keys) else { return Ok(None) };
        let value = self.finite(&key, &text)?;
        if (lowest..=highest).contains(&value) {
            return Ok(Some(value));
        }
        Err(self.wrong(format!("{key}={value} is not in {lowest}..={highest}")))
    }

    /// Whether a word is there.
    fn has(&self, key: &str) -> bool {
        self.pairs.iter().any(|(known, _)| known == key)
    }

    /// Two numbers, if given.
    fn pair(&mut self, keys: &[&str]) -> Result<Option<[f32; 2]>, WordsError> {
        let Some((key, text)) = self.take(keys) else { return Ok(None) };
        let parts: Vec<f32> =
            text.split(',').map(|part| self.finite(&key, part)).collect::<Result<_, _>>()?;
        <[f32; 2]>::try_from(parts)
            .map(Some)
            .map_err(|_| self.wrong(format!("'{key}={text}' needs two numbers w,h")))
    }

    /// Three numbers, if given.
    fn vector(&mut self, keys: &[&str]) -> Result<Option<Vec3>, WordsError> {
        Ok(self.keyed_vector(keys)?.map(|(_, vector)| vector))
    }

    /// Three numbers with their key as it was given.
    fn keyed_vector(&mut self, keys: &[&str]) -> Result<Option<(String, Vec3)>, WordsError> {
        let Some((key, text)) = self.take(keys) else { return Ok(None) };
        let parts: Vec<f32> =
            text.split(',').map(|part| self.finite(&key, part)).collect::<Result<_, _>>()?;
        match parts[..] {
            [x, y, z] => Ok(Some((key, Vec3::new(x, y, z)))),
            _ => Err(self.wrong(format!("'{key}={text}' needs three numbers x,y,z"))),
        }
    }

    /// A colour, if given: three numbers, none negative.
    fn colour(&mut self, key: &str) -> Result<Option<Vec3>, WordsError> {
        let colour = self.vector(&[key])?;
        if colour.is_some_and(|colour| colour.min_element() < 0.0) {
            return Err(self.wrong(format!("'{key}' has a negative part")));
        }
        Ok(colour)
    }

    /// A direction, normalised, if given.
    fn direction(&mut self, keys: &[&str]) -> Result<Option<Vec3>, WordsError> {
        let Some((key, vector)) = self.keyed_vector(keys)? else { return Ok(None) };
        vector.try_normalize().map(Some).ok_or_else(|| self.wrong(format!("'{key}' has no length")))
    }

    /// The value, or an error that says that `key` is missing.
    fn required<T>(&self, key: &str, value: Option<T>) -> Result<T, WordsError> {
        value.ok_or_else(|| self.wrong(format!("'{key}' is missing")))
    }

    /// Every word must have been taken.
    fn end(self) -> Result<(), WordsError> {
        match self.pairs.first() {
            Some((key, _)) => Err(self.wrong(format!("unknown word '{key}'"))),
            None => Ok(()),
        }
    }

    fn finite(&self, key: &str, text: &str) -> Result<f32, WordsError> {
        match text.trim().parse::<f32>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(self.wrong(format!("'{text}' in '{key}' is not finite"))),
            Err(_) => Err(self.wrong(format!("'{text}' in '{key}' is not a number"))),
        }
    }
}
