//! Pictures of an evaluation as files with a list, which a page of another's reads: it takes no HTML from anyone.

use std::path::Path;

use lightkiln_client::fetch::write_atomically;
use lightkiln_client::picture::encode_png;
use serde::{Deserialize, Serialize};

use super::heat::Bitmap;
use super::pictures::LightPictures;
use super::table::LightRow;
use crate::failure::{Exit, Failure, Result};

/// Name of the list in an evaluation's folder.
pub const LIST: &str = "pictures.json";
/// Folder of the pictures beside it.
pub const FOLDER: &str = "pictures";

/// The list.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gallery {
    /// Light by light.
    pub lights: Vec<GalleryLight>,
}

/// The pictures of one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GalleryLight {
    /// Its name.
    pub name: String,
    /// Its type and place, in words.
    pub words: String,
    /// Its pictures.
    pub pictures: Vec<GalleryPicture>,
}

/// A picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GalleryPicture {
    /// File in [`FOLDER`].
    pub file: String,
    /// Caption.
    pub words: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
}

/// Pictures with their captions.
type Captioned<'a> = Vec<(String, &'a Bitmap)>;

/// The pictures of a light: four of the view, and those of the atlas.
pub fn captioned(light: &LightPictures) -> (Captioned<'_>, Captioned<'_>) {
    let of_view = vec![
        ("baked: E_ind of the bake, exact direct light".to_owned(), &light.baked),
        ("reference: path traced".to_owned(), &light.reference),
        ("baked − reference".to_owned(), &light.heat),
        (format!("ꟻLIP, mean {:.4}", light.flip_mean), &light.flip),
    ];
    let of_atlas = light.atlas.iter().enumerate().map(|(page, picture)| {
        let words = format!(
            "atlas page {page}: baked − reference of E_ind, each texel as the nearest receiver measured"
        );
        (words, picture)
    });
    (of_view, of_atlas.collect())
}

/// Writes the pictures of all lights, and the list last.
pub fn write_gallery(out: &Path, pictures: &[LightPictures], rows: &[LightRow]) -> Result<()> {
    let folder = out.join(FOLDER);
    std::fs::create_dir_all(&folder).map_err(|error| {
        Failure::bad_input(format!("the folder {} cannot be made", folder.display())).caused_by(&error)
    })?;
    let mut gallery = Gallery::default();
    for (number, (light, row)) in pictures.iter().zip(rows).enumerate() {
        let (of_view, of_atlas) = captioned(light);
        let mut listed = Vec::new();
        for (at, (words, picture)) in of_view.into_iter().chain(of_atlas).enumerate() {
            let file = format!("{number}-{at}.png");
            write_atomically(&folder.join(&file), &png_of(picture)?)?;
            listed.push(GalleryPicture { file, words, width: picture.width, height: picture.height });
        }
        let (name, words) = (light.name.clone(), row.words.clone());
        gallery.lights.push(GalleryLight { name, words, pictures: listed });
    }
    let list = format!("{:#}\n", serde_json::json!(gallery));
    Ok(write_atomically(&out.join(LIST), list.as_bytes())?)
}

/// A picture as PNG.
pub fn png_of(picture: &Bitmap) -> Result<Vec<u8>> {
    encode_png(picture.width, picture.height, &picture.pixels)
        .map_err(|error| Failure::new(Exit::Failed, "a picture cannot be encoded").caused_by(&*error))
}
