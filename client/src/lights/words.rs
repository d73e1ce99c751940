//! `key=value` words of a camera or light on the command line, with errors that name the bad word.

use glam::Vec3;

use crate::error::{ClientError, Result};

/// The words of one argument; each is taken once, and any left over is an error.
pub(super) struct Words<'a> {
    text: &'a str,
    grammar: &'static str,
    pairs: Vec<(&'a str, &'a str)>,
}

impl<'a> Words<'a> {
    /// Splits `words` of the argument `text`; `grammar` is shown in every error.
    pub fn new(text: &'a str, words: impl Iterator<Item = &'a str>, grammar: &'static str) -> Result<Self> {
        let mut this = Self { text, grammar, pairs: Vec::new() };
        for word in words {
            let Some((key, value)) = word.split_once('=') else {
                return Err(this.wrong(format!("'{word}' is not key=value")));
            };
            if this.pairs.iter().any(|(known, _)| *known == key) {
                return Err(this.wrong(format!("'{key}' is given twice")));
            }
            this.pairs.push((key, value));
        }
        Ok(this)
    }

    pub fn wrong(&self, problem: impl AsRef<str>) -> ClientError {
        ClientError::Argument {
            what: format!("\"{:.200}\"", self.text),
            problem: format!("{}; write \"{}\"", problem.as_ref(), self.grammar),
        }
    }

    fn take(&mut self, key: &str) -> Option<&'a str> {
        let index = self.pairs.iter().position(|(known, _)| *known == key)?;
        Some(self.pairs.remove(index).1)
    }

    /// A number, if given.
    pub fn number(&mut self, key: &str) -> Result<Option<f32>> {
        self.take(key).map(|value| self.finite(key, value)).transpose()
    }

    /// A number in `lowest..=highest`, if given.
    pub fn number_in(&mut self, key: &str, lowest: f32, highest: f32) -> Result<Option<f32>> {
        match self.number(key)? {
            Some(value) if !(lowest..=highest).contains(&value) => {
                Err(self.wrong(format!("{key}={value} is not in {lowest}..={highest}")))
            }
            value => Ok(value),
        }
    }

    /// Three numbers, or one for all three, if given.
    pub fn vector(&mut self, key: &str) -> Result<Option<Vec3>> {
        let Some(value) = self.take(key) else { return Ok(None) };
        let parts: Vec<f32> = value.split(',').map(|part| self.finite(key, part)).collect::<Result<_>>()?;
        match parts[..] {
            [x, y, z] => Ok(Some(Vec3::new(x, y, z))),
            _ => Err(self.wrong(format!("'{key}={value}' needs three numbers x,y,z"))),
        }
    }

    /// A colour: three numbers, none negative; white unless given.
    pub fn colour(&mut self, key: &str) -> Result<Vec3> {
        let colour = self.vector(key)?.unwrap_or(Vec3::ONE);
        if colour.min_element() < 0.0 {
            return Err(self.wrong(format!("'{key}' has a negative part")));
        }
        Ok(colour)
    }

    /// A direction, normalised, if given.
    pub fn direction(&mut self, key: &str) -> Result<Option<Vec3>> {
        let Some(vector) = self.vector(key)? else { return Ok(None) };
        match vector.try_normalize() {
            Some(unit) => Ok(Some(unit)),
            None => Err(self.wrong(format!("'{key}' has no length"))),
        }
    }

    /// The value, or an error that says that `key` is missing.
    pub fn required<T>(&self, key: &str, value: Option<T>) -> Result<T> {
        value.ok_or_else(|| self.wrong(format!("'{key}' is missing")))
    }

    /// Every word must have been taken.
    pub fn end(self) -> Result<()> {
        match self.pairs.first() {
            Some((key, _)) => Err(self.wrong(format!("unknown word '{key}'"))),
            None => Ok(()),
        }
    }

    fn finite(&self, key: &str, value: &str) -> Result<f32> {
        let number = value.trim().parse::<f32>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| self.wrong(format!("'{value}' in '{key}' is not a number")))
    }
}
