//! Objects in the browser: files are read as the native client reads them at every time, and light and pictures with them are the native
//! ones.

mod drawing;
mod packed;
mod rare;
mod reading;
pub mod toy;

use lightkiln_worker::objects::ObjectFile;
use lightkiln_worker::scene::{Bundle as Upload, Limits};
use serde_json::Value;

use super::bytes_of_hex;

const MODULE: &str = "/pages/objects.js";

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn floats(hex: &Value) -> Vec<f32> {
    let number = |four: &[u8]| f32::from_le_bytes(four.try_into().unwrap());
    bytes_of_hex(hex).chunks_exact(4).map(number).collect()
}

fn opened(file: &[u8]) -> Result<ObjectFile, String> {
    let upload = Upload::from_bytes(file.to_vec(), &Limits::default());
    upload.and_then(ObjectFile::open).map(|(object, _)| object).map_err(|error| error.to_string())
}
