//! `--sky FILE`: a panorama as the sky of pictures and evaluations.

use std::path::PathBuf;
use std::sync::Arc;

use lightkiln_client::lights::{Panorama, read_panorama};
use lightkiln_proto::words::panorama_from_text;

use crate::failure::{Failure, Result};

/// A file of a panorama, its turn and strength.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyArgument {
    file: PathBuf,
    turn_deg: f32,
    strength: f32,
}

/// Reads `FILE turn=degrees strength=s`.
pub fn parse_sky(text: &str) -> std::result::Result<SkyArgument, String> {
    let (file, [turn_deg, strength]) = panorama_from_text(text).map_err(|error| error.to_string())?;
    Ok(SkyArgument { file: file.into(), turn_deg, strength })
}

impl SkyArgument {
    /// Reads the file.
    pub fn read(&self) -> Result<Arc<Panorama>> {
        let image = Arc::new(read_panorama(&self.file)?);
        Panorama::new(image, self.turn_deg, self.strength).map(Arc::new).map_err(Failure::bad_input)
    }
}
