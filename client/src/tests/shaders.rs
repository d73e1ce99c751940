//! Every shader parses and validates, and its structs are those of Rust, byte for byte.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::mem::offset_of;
use std::path::Path;

use lightkiln_proto::relight::{
    Column, Detail, LodView, NearHit, NearRow, OwnSurface, PatchRow, StandIn, WalkedRow,
};
use lightkiln_proto::voxels::{BrickRow, ElementRow};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Statement, TypeInner};

use crate::kinds::field::{self, LatticeNumbers, TetrahedraNumbers};
use crate::kinds::sh::relight::{self, RelightNumbers};
use crate::passes::around::{self, MixNumbers, PartOwn, PartShare, ViewpointNumbers};
use crate::passes::atlas::{AtlasNumbers, AtlasTexel, INDIRECT, Placement};
use crate::passes::basis::BasisNumbers;
use crate::passes::change::ChangeNumbers;
use crate::passes::direct::{self, TexelNumbers};
use crate::passes::fog::{self, FogNumbers};
use crate::passes::lod::{FillNumbers, TurnNumbers};
use crate::passes::meter::MeterNumbers;
use crate::passes::near::{self, NearNumbers};
use crate::passes::patches::PatchNumbers;
use crate::passes::place::PlaceNumbers;
use crate::passes::reconstruct::ReconstructNumbers;
use crate::passes::resident::ClusterRow;
use crate::passes::shade::{PanoramaNumbers, ShadeDraw, ShadeView, Shading};
use crate::passes::shadow::{Face, Light, LightCount, Mask, Pane};
use crate::passes::show::ShowNumbers;
use crate::passes::transfer::{self, FeedNumbers, MovedNumbers, MoverLevelRow, MoverNumbers, MoverRow};
use crate::passes::walk::{self, WalkNumbers, WalkPixels};
use crate::passes::walked::{self, WalkedNumbers};
use crate::web;

/// Every shader: name and whole source, as the adapter compiles it.
fn shaders() -> Vec<(&'static str, String)> {
    let of_browsers = web::shaders().into_iter().map(|(name, source)| (name, source.into_owned()));
    let with = |snippet| Shading { snippet, bindings: Vec::new() }.shader();
    let fields = [
        ("shade with a field on a lattice", with(field::IN_LATTICE)),
        ("shade with a field in tetrahedra", with(field::IN_TETRAHEDRA)),
        ("shade with a lattice alone", with(field::LATTICE_ALONE)),
        ("shade with tetrahedra alone", with(field::TETRAHEDRA_ALONE)),
    ];
    let all =
        [INDIRECT, field::IN_LATTICE, field::IN_TETRAHEDRA, field::LATTICE_ALONE, field::TETRAHEDRA_ALONE];
    let objects = all.map(|snippet| {
        ("shade with objects", Shading { snippet, bindings: Vec::new() }.shader_with_objects())
    });
    let others = [
        ("direct-texels-placed", direct::PLACED_TEXELS_SHADER),
        ("near-lit-placed", near::PLACED_LIT_SHADER),
        ("transfer", transfer::TEXELS_SHADER),
        ("transfer-feed", transfer::FEED_SHADER),
        ("around-look", around::LOOK_SHADER),
        ("around-means", around::MEANS_SHADER),
        ("around-parts", around::PARTS_SHADER),
        ("around-mix", around::MIX_SHADER),
        ("relight", relight::SHADER),
        ("dering", field::DERING_SHADER),
        ("fog-over", fog::OVER_SHADER),
        ("walk", walk::SHADER),
        ("walked", walked::SHADER),
    ];
    let fogs = [fog::NO_RADIANCE, field::LATTICE_MEDIUM, field::TETRAHEDRA_MEDIUM];
    let fogs = fogs.map(|radiance| ("fog", [fog::FILL_SHADER, radiance].concat()));
    of_browsers
        .chain(others.map(|(name, source)| (name, source.to_owned())))
        .chain(objects)
        .chain(fields)
        .chain(fogs)
        .collect()
}

fn parsed(source: &str) -> naga::Module {
    naga::front::wgsl::parse_str(source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)))
}

#[test]
fn every_shader_parses_and_validates() {
    for (name, source) in shaders() {
        let module = parsed(&source);
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        if let Err(error) = validator.validate(&module) {
            panic!("{name}: {}", error.emit_to_string(&source));
        }
        assert!(!module.entry_points.is_empty(), "{name}");
    }
}

/// Functions that a block calls, as often as it names them.
fn calls(block: &naga::Block, found: &mut Vec<naga::Handle<naga::Function>>) {
    for statement in block {
        match statement {
            Statement::Call { function, .. } => found.push(*function),
            Statement::Block(inner) => calls(inner, found),
            Statement::If { accept, reject, .. } => {
                [accept, reject].into_iter().for_each(|inner| calls(inner, found));
            }
            Statement::Switch { cases, .. } => cases.iter().for_each(|case| calls(&case.body, found)),
            Statement::Loop { body, continuing, .. } => {
                [body, continuing].into_iter().for_each(|inner| calls(inner, found));
            }
            _ => {}
        }
    }
}

/// Copies of a function in another where all calls are inlined, as adapters do.
fn copies(module: &naga::Module, of: &str, within: &naga::Function) -> usize {
    let mut found = Vec::new();
    calls(&within.body, &mut found);
    let copies = found.into_iter().map(|handle| match &module.functions[handle] {
        called if called.name.as_deref() == Some(of) => 1,
        called => copies(module, of, called),
    });
    copies.sum()
}

/// Adapters that run on the processor compile each copy for seconds: pictures wait for them.
#[test]
fn look_ups_are_inlined_once() {
    const LONG: [&str; 8] = [
        "visibility",
        "is_behind",
        "from_probes",
        "with_probe",
        "lightmap_irradiance",
        "microfacets",
        "end_of",
        "met_at",
    ];
    let mut seen = BTreeMap::new();
    for (name, source) in shaders() {
        let module = parsed(&source);
        for entry in &module.entry_points {
            for long in LONG {
                let count = copies(&module, long, &entry.function);
                assert!(count <= 1, "{name}: {} has {count} copies of {long}", entry.name);
                *seen.entry(long).or_insert(0) += count;
            }
        }
    }
    assert!(seen.values().all(|count| *count > 0), "{seen:?}");
    assert!(seen["visibility"] >= 8, "{seen:?}");
}

#[test]
fn every_shader_file_is_part_of_a_listed_shader() {
    let mut files = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "wgsl") {
                files.push(path);
            }
        }
    }
    let shaders = shaders();
    assert!(files.len() > shaders.len(), "only {} shader files found", files.len());
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        let is_part = shaders.iter().any(|(_, source)| source.contains(&text));
        assert!(is_part, "{} is in no shader", file.display());
        assert!(text.lines().count() <= 250, "{} is longer than 250 lines", file.display());
    }
}

/// [`crate::passes::gpu::Gpu::created`] counts what is made: so nothing else may make anything.
#[test]
fn what_is_made_on_the_adapter_is_made_in_one_place() {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                let makes = text.lines().filter(|line| {
                    line.replace(".create_view(", "")
                        .replace(".create_window(", "")
                        .replace(".create_proxy(", "")
                        .contains(concat!(".", "create_"))
                });
                let is_home = path.ends_with("passes/gpu.rs");
                seen += if is_home {
                    makes.count()
                } else {
                    makes.map(|line| panic!("{path:?}: {line}")).count()
                };
            }
        }
    }
    assert!(seen >= 10, "{seen} places");
}

/// A struct: size, and names and offsets of its fields.
#[derive(Debug, PartialEq)]
struct Layout {
    size: usize,
    fields: Vec<(String, usize)>,
}

macro_rules! twins {
    ($($name:literal: $kind:ty { $($field:ident),+ $(,)? })+) => {
        BTreeMap::from([$(($name, Layout {
            size: size_of::<$kind>(),
            fields: vec![$((stringify!($field).to_owned(), offset_of!($kind, $field))),+],
        })),+])
    };
}

/// The Rust twin of every struct that a shader reads or writes through a binding, by its name in WGSL.
fn twins() -> BTreeMap<&'static str, Layout> {
    twins! {
        "FeedNumbers": FeedNumbers { count, stride }
        "MixNumbers": MixNumbers { count, stride, words }
        "MovedNumbers": MovedNumbers { rows, count, stride, own, pad }
        "Mover": MoverRow { rows, middle_m, half_side_m, scale, points, pad1, pad2, levels }
        "MoverLevel": MoverLevelRow { stops_m, outer, half_m, inner, nodes, first_part, part_count, first_code, pad }
        "Movers": MoverNumbers { count, first_light, first_face, first_layer, first_of_light, first_point, first_silhouette, pad, each }
        "PartOwn": PartOwn { middle_m, first, emitted, count }
        "PartShare": PartShare { place, share }
        "Place": PlaceNumbers { rows }
        "Viewpoints": ViewpointNumbers { rows, middle_m, count, half_m, walks, counts, parts, open, tangent, part_count, first_light, pad0, pad1, pad2, pointed }
        "BrickRow": BrickRow { cell, level }
        "ElementRow": ElementRow { normal, height_m, bits, patch_number, marks }
        "Pixels": WalkPixels {
            size, cells, step, turn, reflections, occlusion, irradiance, reach_m, pad, world_from_clip
        }
        "Voxels": WalkNumbers {
            low, top, high, finest, voxel_m, levels, slot_last, first_of_sky, sky_parts, first_direction, bricks, pad
        }
        "Atlas": AtlasNumbers { texel_count, stride }
        "AtlasTexel": AtlasTexel { x, y, first, packed, kind }
        "Basis": BasisNumbers { stride, cluster_count, first_cluster }
        "Change": ChangeNumbers { receiver_count, stride }
        "Cluster": ClusterRow {
            first_row, row_count, first_column, column_count, rank, first_b, first_word, wide, wide_words,
            bytes
        }
        "Column": Column { place, scale }
        "Detail": Detail { first_row, row_count, rows, wide, bytes, rest, groups, level, interval }
        "Face": Face { clip_from_world, right, texel_at_unit_w, up, panes }
        "LatticeField": LatticeNumbers { low, size, spacing_m, first_probe, probe_count, pad }
        "TetrahedraField": TetrahedraNumbers { low_m, high_m, cells, cell_m, spacing_m, first_probe, probe_count }
        "Fill": FillNumbers { count, stride, level }
        "Fog": FogNumbers {
            size, picture, eye, eye_per_x, eye_per_y, ray, ray_per_x, ray_per_y, by_depth
        }
        "Light": Light {
            position, range_m, direction, shape, strength, first_face, cone_cos_inner, cone_cos_outer, face_count,
            half_extent, first_cascade, cascades, half_size_m, cells, pad
        }
        "LightCount": LightCount { count, side, bias_m, snap }
        "LodView": LodView {
            position_m, view_cos, forward, beside, starts_m, behind, ends_m, pad
        }
        "Mask": Mask { uv_row0, uv_row1, alpha, cutoff, pad0, pad1 }
        "Meter": MeterNumbers { columns, rows, width, height }
        "Near": NearNumbers { row_count, stride }
        "NearHit": NearHit { position_m, light }
        "NearRow": NearRow { slot, first, count, weight }
        "OwnSurface": OwnSurface { normal, albedo }
        "Pane": Pane {
            base_row0, base_row1, transmission_row0, transmission_row1, base_colour, transmission, blends, cutoff, pad
        }
        "PanoramaNumbers": PanoramaNumbers { turn, strength, pad }
        "PatchRow": PatchRow { first_leaf, leaf_count, parent }
        "Patches": PatchNumbers {
            receiver_count, leaf_count, patch_count, stride, first_block, first_large, block_source
        }
        "Placement": Placement { front, front_size, back, back_size }
        "Reconstruct": ReconstructNumbers { stride, cluster_count, has_beside, first_cluster }
        "Relight": RelightNumbers { first_probe, receiver_count, rays, coefficients }
        "ShadeDraw": ShadeDraw {
            base_colour, emissive, base_row0, base_row1, emissive_row0, emissive_row1, transmission_row0,
            transmission_row1, normal_row0, normal_row1, specular_row0, specular_row1, cutoff, index, transmission,
            blends, normal_scale, has_normals, metallic, roughness
        }
        "Show": ShowNumbers { exposure, tone, encodes, pad }
        "StandIn": StandIn { slot, cluster, sources }
        "TexelNumbers": TexelNumbers { first, count, stride, reach_m }
        "Turn": TurnNumbers { bounce, cluster_count, stride }
        "Walked": WalkedNumbers { row_count, stride, weight }
        "WalkedRow": WalkedRow { slot, first, count, has_near }
        "ShadeView": ShadeView { clip_from_world, zenith, horizon, ray, ray_per_x, ray_per_y }
    }
}

/// Structs in buffers that a shader binds, found through arrays and members.
fn bound_structs(module: &naga::Module) -> BTreeMap<String, Layout> {
    let mut found = BTreeMap::new();
    let in_buffer = |space| matches!(space, AddressSpace::Uniform | AddressSpace::Storage { .. });
    let bound = module.global_variables.iter().filter(|(_, variable)| in_buffer(variable.space));
    let mut open: Vec<_> = bound.map(|(_, variable)| variable.ty).collect();
    while let Some(handle) = open.pop() {
        match &module.types[handle].inner {
            TypeInner::Array { base, .. } => open.push(*base),
            TypeInner::Struct { members, span } => {
                open.extend(members.iter().map(|member| member.ty));
                let field = |member: &naga::StructMember| {
                    (member.name.clone().unwrap_or_default(), member.offset as usize)
                };
                let layout = Layout { size: *span as usize, fields: members.iter().map(field).collect() };
                found.insert(module.types[handle].name.clone().unwrap_or_default(), layout);
            }
            _ => {}
        }
    }
    found
}

/// Panics when a bound struct of a shader has no twin or another layout.
fn assert_twins(shader: &str, module: &naga::Module, twins: &BTreeMap<&str, Layout>) -> BTreeSet<String> {
    let found = bound_structs(module);
    for (name, layout) in &found {
        let twin = twins.get(name.as_str()).unwrap_or_else(|| panic!("{shader}: {name} has no Rust twin"));
        assert_eq!(layout, twin, "{shader}: {name} and its Rust twin differ");
    }
    found.into_keys().collect()
}

#[test]
fn every_bound_struct_has_a_rust_twin_of_the_same_layout() {
    let twins = twins();
    let all = shaders();
    let found: BTreeSet<String> =
        all.iter().flat_map(|(name, source)| assert_twins(name, &parsed(source), &twins)).collect();
    let unused: Vec<_> = twins.keys().filter(|name| !found.contains(**name)).collect();
    assert!(unused.is_empty(), "no shader binds {unused:?}");
}

#[test]
#[should_panic(expected = "LightCount and its Rust twin differ")]
fn comparison_of_structs_fails_when_a_field_moves() {
    let moved = crate::passes::direct::TEXELS_SHADER.replacen(
        "    count: u32,\n",
        "    pad_before: u32,\n    count: u32,\n",
        1,
    );
    assert_ne!(moved, crate::passes::direct::TEXELS_SHADER);
    assert_twins("direct", &parsed(&moved), &twins());
}

#[test]
#[should_panic(expected = "Novel has no Rust twin")]
fn comparison_of_structs_fails_when_one_is_not_registered() {
    let novel = "struct Novel { a: u32 } @group(0) @binding(0) var<storage, read> novel: array<Novel>;";
    assert_twins("novel", &parsed(novel), &twins());
}
