//! Files of `client/web` as they are: the page, its modules and styles, and licences of others' code.

macro_rules! files {
    ($($name:literal),+ $(,)?) => { &[$(($name, include_bytes!(concat!("../../web/", $name)))),+] };
}

/// Name, from `client/web` on, and bytes of each file that browsers get; shaders are made by [`shaders`](super::shaders).
pub const MODULES: &[(&str, &[u8])] = files![
    "alone.html",
    "chunk/bytes.js",
    "chunk/cells.js",
    "chunk/cluster.js",
    "chunk/cluster_head.js",
    "chunk/cluster_near.js",
    "chunk/cluster_receivers.js",
    "chunk/column_keys.js",
    "chunk/column_order.js",
    "chunk/column_scale.js",
    "chunk/container.js",
    "chunk/digest.js",
    "chunk/directory.js",
    "chunk/error.js",
    "chunk/factors.js",
    "chunk/fields.js",
    "chunk/geometry.js",
    "chunk/ints.js",
    "chunk/layers.js",
    "chunk/limits.js",
    "chunk/manifest.js",
    "chunk/numbers.js",
    "chunk/patch_key.js",
    "chunk/patches.js",
    "chunk/predict.js",
    "chunk/table.js",
    "chunk/texture.js",
    "chunk/vertices.js",
    "fetch.js",
    "frame/atlas.js",
    "frame/bounces.js",
    "frame/change.js",
    "frame/device.js",
    "frame/direct.js",
    "frame/factors.js",
    "frame/film.js",
    "frame/frame.js",
    "frame/glass.js",
    "frame/gpu.js",
    "frame/halves.js",
    "frame/lights.js",
    "frame/lod.js",
    "frame/lod_words.js",
    "frame/maths.js",
    "frame/meshes.js",
    "frame/near.js",
    "frame/objects.js",
    "frame/pane_maps.js",
    "frame/panorama.js",
    "frame/passes.js",
    "frame/patches.js",
    "frame/plan.js",
    "frame/rectangle.js",
    "frame/resident.js",
    "frame/room.js",
    "frame/same.js",
    "frame/shade.js",
    "frame/shaders.js",
    "frame/shadow.js",
    "frame/snap.js",
    "frame/stage.js",
    "frame/targets.js",
    "frame/textures.js",
    "frame/tone.js",
    "frame/view.js",
    "frame/words.js",
    "icon.svg",
    "index.html",
    "object/accessor.js",
    "object/affine.js",
    "object/animation.js",
    "object/document.js",
    "object/error.js",
    "object/file.js",
    "object/glb.js",
    "object/image.js",
    "object/limits.js",
    "object/materials.js",
    "object/meshopt.js",
    "object/meshopt_filters.js",
    "object/object.js",
    "object/placement.js",
    "object/primitive.js",
    "object/skin.js",
    "orbit.js",
    "page/alone.js",
    "page/app.js",
    "page/bake.js",
    "page/bakes.js",
    "page/colours.js",
    "page/detail.js",
    "page/dom.js",
    "page/dropped.js",
    "page/evaluation.js",
    "page/evaluation_files.js",
    "page/objects.js",
    "page/pictures.js",
    "page/report.js",
    "page/session.js",
    "page/sky.js",
    "page/turns.js",
    "page/viewer.js",
    "page/words.js",
    "page/workers.js",
    "pick.js",
    "relight/bake.js",
    "relight/clusters.js",
    "relight/draws.js",
    "relight/flat.js",
    "relight/following.js",
    "relight/growing.js",
    "relight/inconsistent.js",
    "relight/layout.js",
    "relight/light_work.js",
    "relight/lod.js",
    "relight/lod_plan.js",
    "relight/lod_table.js",
    "relight/near.js",
    "relight/need.js",
    "relight/numbers.js",
    "relight/packed.js",
    "relight/panorama.js",
    "relight/panorama_image.js",
    "relight/patches.js",
    "relight/prefix.js",
    "relight/radiance_hdr.js",
    "relight/receivers.js",
    "relight/recolour.js",
    "relight/sky.js",
    "relight/sky_parts.js",
    "relight/sky_work.js",
    "relight/slots.js",
    "relight/stand_ins.js",
    "relight/stream.js",
    "relight/texel_points.js",
    "relight/texels.js",
    "relight/worker.js",
    "relight/workers.js",
    "style.css",
    "vendor/noble-hashes/LICENSE",
    "vendor/noble-hashes/_blake.js",
    "vendor/noble-hashes/_md.js",
    "vendor/noble-hashes/_u64.js",
    "vendor/noble-hashes/blake2.js",
    "vendor/noble-hashes/blake3.js",
    "vendor/noble-hashes/utils.js",
    "view.js",
    "zstd/bits.js",
    "zstd/error.js",
    "zstd/frame.js",
    "zstd/fse.js",
    "zstd/huffman.js",
    "zstd/literals.js",
    "zstd/sequences.js",
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::*;

    fn names_below(folder: &Path, root: &Path, names: &mut BTreeSet<String>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let is_shader = path.extension().is_some_and(|ending| ending == "wgsl");
            if path.is_dir() {
                names_below(&path, root, names);
            } else if !is_shader && !path.ends_with("README.md") {
                names.insert(path.strip_prefix(root).unwrap().to_str().unwrap().to_owned());
            }
        }
    }

    #[test]
    fn every_file_of_the_folder_is_handed_out() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("web");
        let mut found = BTreeSet::new();
        names_below(&root, &root, &mut found);
        assert!(found.len() > 40, "next to no files: the walk is broken");
        assert_eq!(MODULES.iter().map(|(name, _)| (*name).to_owned()).collect::<BTreeSet<_>>(), found);
    }
}
