//! Every shader parses and validates, and its structs are those of Rust, byte for byte.

use std::fs;
use std::mem::offset_of;
use std::path::Path;

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::bake::{AtlasTexel, PatchRow};
use crate::passes::SHADERS;
use crate::passes::atlas::AtlasNumbers;
use crate::passes::basis::BasisNumbers;
use crate::passes::direct::DirectNumbers;
use crate::passes::patches::PatchNumbers;
use crate::passes::reconstruct::ReconstructNumbers;
use crate::passes::relight::RelightNumbers;
use crate::passes::resident::ClusterRow;
use crate::passes::shade::{ShadeDraw, ShadeView};
use crate::passes::shadow::{Face, Light, LightCount, Mask};

fn parsed(name: &str) -> naga::Module {
    let source = SHADERS.iter().find(|(known, _)| *known == name).unwrap().1;
    naga::front::wgsl::parse_str(source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)))
}

#[test]
fn every_shader_parses_and_validates() {
    for (name, source) in SHADERS {
        let module = parsed(name);
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        if let Err(error) = validator.validate(&module) {
            panic!("{name}: {}", error.emit_to_string(source));
        }
        assert!(!module.entry_points.is_empty(), "{name}");
    }
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
    assert!(files.len() > SHADERS.len(), "only {} shader files found", files.len());
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        assert!(
            SHADERS.iter().any(|(_, source)| source.contains(&text)),
            "{} is in no shader",
            file.display()
        );
        assert!(text.lines().count() <= 250, "{} is longer than 250 lines", file.display());
    }
}

/// A Rust struct: size, and names and offsets of its fields.
type Layout = (usize, Vec<(&'static str, usize)>);

macro_rules! layout {
    ($kind:ty: $($field:ident),+) => {
        (size_of::<$kind>(), vec![$((stringify!($field), offset_of!($kind, $field))),+])
    };
}

fn assert_twins(shader: &str, name: &str, (size, fields): Layout) {
    let module = parsed(shader);
    let found = module.types.iter().find(|(_, kind)| kind.name.as_deref() == Some(name));
    let Some((_, naga::Type { inner: naga::TypeInner::Struct { members, span }, .. })) = found else {
        panic!("{shader}: no struct {name}");
    };
    let theirs: Vec<(&str, usize)> =
        members.iter().map(|member| (member.name.as_deref().unwrap_or(""), member.offset as usize)).collect();
    assert_eq!(theirs, fields, "{shader}: fields of {name}");
    assert_eq!(*span as usize, size, "{shader}: size of {name}");
}

#[test]
fn structs_of_shaders_and_rust_agree_in_names_offsets_and_sizes() {
    for shader in ["direct", "shade"] {
        let light = layout!(Light: position, range_m, direction, shape, strength, first_face, cone_cos_inner,
            cone_cos_outer, face_count, half_extent);
        assert_twins(shader, "Light", light);
        assert_twins(shader, "Face", layout!(Face: clip_from_world, right, texel_at_unit_w, up, pad));
        assert_twins(shader, "LightCount", layout!(LightCount: count, side, bias_m, pad));
    }
    for shader in ["basis", "reconstruct"] {
        let row = layout!(ClusterRow: first_receiver, receiver_count, first_support, support_count, coefficients,
            rank, first_b, first_factor);
        assert_twins(shader, "Cluster", row);
    }
    assert_twins("direct", "Receivers", layout!(DirectNumbers: count, stride));
    assert_twins("shadow", "Mask", layout!(Mask: uv_row0, uv_row1, alpha, cutoff, pad0, pad1));
    assert_twins("atlas", "AtlasTexel", layout!(AtlasTexel: x, y, first, packed));
    assert_twins("atlas", "Atlas", layout!(AtlasNumbers: texel_count, stride));
    assert_twins("basis", "Basis", layout!(BasisNumbers: coefficients, stride, cluster_count, pad));
    assert_twins("reconstruct", "Reconstruct", layout!(ReconstructNumbers: stride, cluster_count));
    let relight = layout!(RelightNumbers: first_probe, receiver_count, rays, coefficients);
    assert_twins("relight", "Relight", relight);
    let numbers = layout!(PatchNumbers: receiver_count, leaf_count, patch_count, stride);
    assert_twins("patches", "Patches", numbers);
    assert_twins("patches", "PatchRow", layout!(PatchRow: first_leaf, leaf_count));
    let view = layout!(ShadeView: clip_from_world, zenith, horizon, ray, ray_per_x, ray_per_y);
    assert_twins("shade", "ShadeView", view);
    let draw = layout!(ShadeDraw: base_colour, emissive, base_row0, base_row1, emissive_row0, emissive_row1, front,
        front_size, back, back_size, cutoff, pad0, pad1, pad2);
    assert_twins("shade", "ShadeDraw", draw);
}

#[test]
#[should_panic(expected = "fields of LightCount")]
fn comparison_of_structs_fails_when_a_field_differs() {
    assert_twins("direct", "LightCount", layout!(LightCount: count, bias_m, side, pad));
}

#[test]
#[should_panic(expected = "size of Receivers")]
fn comparison_of_structs_fails_when_the_size_differs() {
    assert_twins("direct", "Receivers", (12, vec![("count", 0), ("stride", 4)]));
}
