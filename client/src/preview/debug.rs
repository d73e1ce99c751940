//! Pictures for finding faults, as the bake's kind draws them.

use super::{Prepared, View};
use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};
use crate::passes::shadow::reference::draw;
use crate::picture::{Film, Picture};

/// Page `page` of a picture of [`crate::bake::Light::debug_pictures`], on the processor.
pub fn debug_picture(bake: &LoadedBake, view: &View, name: &str, page: usize) -> Result<Picture> {
    let known = bake.light.debug_pictures(&bake.scene);
    let Some((_, pages)) = known.iter().find(|(known, _)| *known == name) else {
        let names: Vec<&str> = known.iter().map(|(known, _)| *known).collect();
        let known = if names.is_empty() { "it has none".to_owned() } else { names.join(", ") };
        let kind = &bake.scene.manifest.kind;
        let problem = format!("is no picture of kind '{kind}' for finding faults: {known}");
        return Err(ClientError::Argument { what: name.to_owned(), problem });
    };
    let prepared = Prepared::new(bake, view)?;
    let maps = draw(&prepared.scene, &prepared.plan);
    let found = bake.light.debug_page(name, page, &prepared.lit(&maps), view.limit);
    let drawn = found.ok_or_else(|| ClientError::Argument {
        what: format!("page {page}"),
        problem: format!("is not there; picture '{name}' has {pages} pages"),
    })?;
    let mut film = Film::new(drawn.size, view.tone, view.exposure, &drawn.texels);
    film.add(&drawn.texels);
    let (bounces, converged) = (drawn.bounces, drawn.converged);
    let drawn_by = "the processor".to_owned();
    Ok(Picture { drawn_by, by_reference: true, bounces, converged, ..film.develop() })
}
