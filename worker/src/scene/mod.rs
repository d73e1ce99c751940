//! Scene import: glTF and GLB to one flat, validated [`model::Scene`].
//!
//! An upload is a [`Bundle`]; [`import`] turns it into an [`model::Imported`]. Nothing here trusts a size, an index or
//! a name of the file: every one is compared with the bytes that are there and with [`Limits`] before it is used.

mod accessor;
mod animation;
mod beside;
mod buffers;
mod bundle;
mod census;
mod context;
pub mod core;
mod details;
mod document;
mod draco;
mod error;
mod glass;
mod glb;
mod images;
mod inside_out;
mod json_text;
mod lights_cameras;
mod limits;
mod materials;
mod meshopt;
pub mod model;
pub mod movers;
mod moving;
mod nodes;
mod oddities;
mod outline;
mod pack;
mod placement;
mod pose;
mod primitives;
mod shells;
pub mod surface;
pub mod task;
pub mod texture;
mod unzip;
mod uri;
mod warnings;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

pub use bundle::Bundle;
pub use error::ImportError;
pub use limits::Limits;
pub use moving::MovingFile;

use buffers::Buffers;
use context::{Budgets, Context};
use materials::MaterialTable;
use model::{Imported, Scene};
use warnings::Warnings;

/// Magic of the imported-scene artefact.
pub const ARTEFACT_MAGIC: &[u8; 4] = b"LKsc";
/// Name under which tasks see it.
pub const ARTEFACT: &str = "import/scene";
/// Code of the warning that says why there is nothing to bake.
const NO_TRIANGLES: &str = "no-triangles";
/// Magic of the artefact of images for pictures alone.
pub const DETAILS_MAGIC: &[u8; 4] = b"LKsd";
/// Name under which `scene.draw` sees it.
pub const DETAILS: &str = "import/details";
/// Name under which tasks see the import's warnings.
pub const WARNINGS: &str = "import/warnings";

/// Reads the bundle's glTF as one flat scene in world space.
///
/// The result is a pure function of the bundle. Errors say fault, place and remedy; whatever is merely
/// not honoured becomes a warning.
pub fn import(source: &Bundle, limits: &Limits) -> Result<Imported, ImportError> {
    opened(source, limits, Opening::Still, |context| {
        let mut materials = MaterialTable::read(context)?;
        let mut scene = Scene::default();
        let degenerate_count = nodes::flatten(context, &mut materials, &mut scene)?;
        let details;
        (scene.materials, scene.images, details) = materials.finish();
        if scene.instances.is_empty() {
            let why = nothing_to_bake(context.root, degenerate_count);
            context.warnings.add(NO_TRIANGLES, || why);
        }
        let counts = counts(&scene, degenerate_count);
        Ok(Imported { scene, details, warnings: std::mem::take(&mut context.warnings).finish(), counts })
    })
}

/// Purpose for which a file is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Opening {
    /// To be baked as it stands: triangles without area are dropped, animations are not read.
    Still,
    /// To move: all triangles are kept, so that they are the same at all times.
    Moving,
}

/// Calls `work` with the document of a bundle and its bytes.
fn opened<T>(
    bundle: &Bundle,
    limits: &Limits,
    opening: Opening,
    work: impl FnOnce(&mut Context<'_>) -> Result<T, ImportError>,
) -> Result<T, ImportError> {
    let (root, bin) = document::parse(bundle.root_bytes(), limits)?;
    let buffers = Buffers::load(&root, bin, bundle, limits, opening)?;
    let budgets = Budgets::new(limits, bundle.upload_bytes());
    let warnings = Warnings::default();
    let mut context = Context { root: &root, bundle, buffers: &buffers, limits, budgets, warnings, opening };
    document::warn_of_ignored_extensions(&root, opening, &mut context.warnings);
    work(&mut context)
}

/// Why a scene has no triangles, and what to do.
fn nothing_to_bake(root: &gltf::json::Root, degenerate_count: u64) -> String {
    let mesh_count = root.meshes.len();
    let is_placed = root.nodes.iter().any(|node| node.mesh.is_some());
    let why = if degenerate_count > 0 {
        format!("all of its {degenerate_count} triangles are without area; check that no node is scaled to 0")
    } else if mesh_count > 0 && !is_placed {
        format!("the file has {mesh_count} mesh(es), but no node places one; export the scene with its nodes")
    } else if mesh_count > 0 {
        "no mesh under the nodes of its scene has triangles; check which scene and objects were exported"
            .into()
    } else {
        "the file has no meshes; export the scene with its geometry".into()
    };
    format!("the scene has no triangles to bake: {why}")
}

fn counts(scene: &Scene, degenerate_count: u64) -> BTreeMap<String, u64> {
    let instances = &scene.instances;
    let pixels = |image: &model::SceneImage| u64::from(image.size_px[0]) * u64::from(image.size_px[1]);
    let counted = [
        ("cameras", scene.cameras.len() as u64),
        ("degenerate_triangles", degenerate_count),
        ("image_pixels", scene.images.iter().map(pixels).sum()),
        ("images", scene.images.len() as u64),
        ("instances", instances.len() as u64),
        ("lights", scene.lights.len() as u64),
        ("materials", scene.materials.len() as u64),
        ("triangles", instances.iter().map(|instance| instance.triangles.len() as u64).sum()),
        ("vertices", instances.iter().map(|instance| instance.positions_m.len() as u64).sum()),
    ];
    counted.into_iter().map(|(name, count)| (name.to_owned(), count)).collect()
}
