//! FORMAT.md says what the code does.

use crate::chunk::container;
use crate::chunk::*;
use crate::kinds::Kinds;
use crate::kinds::field::{PART_PROBES_MAX, TETRAHEDRA_MAX};
use crate::kinds::sh::{BATCH_PROBES_MAX, HITS_MAX, RELIGHT_RAYS_MAX};
use crate::{transfer, voxels};

const FORMAT: &str = include_str!("../../../FORMAT.md");

fn assert_row(row: &str) {
    assert!(
        FORMAT.lines().any(|line| line.starts_with(row)),
        "FORMAT.md has no line that starts with '{row}'"
    );
}

#[test]
fn magic_version_kinds_and_tags_are_those_of_the_code() {
    assert_row(&format!("| magic | `{}` |", String::from_utf8_lossy(&MAGIC)));
    assert_row(&format!("| version | {VERSION} |"));
    assert_row(&format!("# Chunk format, version {VERSION}"));
    for row in Kinds::new().chunks() {
        assert_row(&format!("| kind {} | {} |", row.name, row.kind.0));
        for (tag, section) in row.sections {
            assert_row(&format!("| {} {section} | {tag} |", row.name));
        }
    }
}

#[test]
fn limits_are_those_of_the_code() {
    use limits::*;
    let rows = [
        ("receivers in a cluster", RECEIVERS_MAX),
        ("column keys of a cluster", CLUSTER_KEYS_MAX),
        ("rank", RANK_MAX),
        ("highest band", BANDS_MAX),
        ("numbers in ΣVᵀ", VT_ENTRIES_MAX),
        ("emitters of a cluster", EMITTERS_MAX),
        ("emitters × receivers", EMITTER_ENTRIES_MAX),
        ("near hits of a cluster", NEAR_HITS_MAX),
        ("blocks named in a cluster, or in a batch of probes", BLOCKS_MAX),
        ("blocks of patches", PATCH_BLOCKS_MAX),
        ("probes in a batch", BATCH_PROBES_MAX),
        ("relight rays of a probe", RELIGHT_RAYS_MAX),
        ("probes × rays", HITS_MAX),
        ("probes in a part of a field", PART_PROBES_MAX),
        ("tetrahedra of a bake", TETRAHEDRA_MAX),
        ("levels of voxels", voxels::LEVELS_MAX as usize),
        ("bricks in a part of voxels", voxels::PART_BRICKS_MAX),
        ("elements in a part of voxels", voxels::PART_ELEMENTS_MAX),
        ("glows in a part of voxels", voxels::GLOWS_MAX),
        ("levels of a volume", transfer::LEVELS as usize),
        ("nodes of a volume's level along an axis", transfer::NODES_MAX as usize),
        ("parts of a volume's level", transfer::PARTS_MAX),
        ("patches of its parts", transfer::PATCHES_MAX),
        ("glows of its parts", transfer::GLOWS_MAX),
        ("surface patches", PATCHES_MAX),
        ("clusters in a page of a directory", DIRECTORY_CLUSTERS_MAX),
        ("receivers of patches", PATCH_RECEIVERS_MAX),
        ("parts of the sky", SKY_PARTS_MAX),
        ("draws", DRAWS_MAX),
        ("vertices", VERTICES_MAX),
        ("triangles", TRIANGLES_MAX),
        ("bytes of a media type", MEDIA_TYPE_BYTES_MAX),
        ("bytes of a texture file", TEXTURE_BYTES_MAX),
        ("bytes of a chunk", CHUNK_BYTES_MAX),
        ("bytes of a head", HEAD_BYTES_MAX),
        ("sections", SECTIONS_MAX),
        ("layers", LAYERS_MAX),
        ("levels", LEVELS_MAX as usize),
    ];
    for (name, limit) in rows {
        assert_row(&format!("| {name} | {limit} |"));
    }
    assert_eq!(
        (EXPANSION_FREE_BYTES, EXPANSION_MAX),
        (16 << 20, 4096),
        "the sentence below the table of limits"
    );
    assert_eq!((HEADER_BYTES, ENTRY_BYTES), (12, 12));
    assert_eq!(container::HEADER_BYTES + ENTRY_BYTES, 24, "header and entry as drawn");
}

#[test]
fn the_worked_example_is_the_fixture() {
    let fixture: &[u8] = include_bytes!("../../../fixtures/cluster-v4.lkc");
    let example =
        FORMAT.split("## A worked example").nth(1).and_then(|rest| rest.split("```").nth(1)).unwrap();
    let mut next = 0;
    for line in example.lines().filter(|line| !line.is_empty()) {
        let (offset, rest) = line.split_once("  ").unwrap();
        assert_eq!(usize::from_str_radix(offset, 16).unwrap(), next, "{line}");
        let hex = rest.split("  ").next().unwrap();
        for byte in hex.split(' ') {
            assert_eq!(u8::from_str_radix(byte, 16).unwrap(), fixture[next], "{line}");
            next += 1;
        }
    }
    let sections = u16::from_le_bytes([fixture[10], fixture[11]]);
    let head = u16::from_le_bytes([fixture[8], fixture[9]]);
    assert_eq!(next, HEADER_BYTES + usize::from(head) + ENTRY_BYTES * usize::from(sections));
    let total = fixture.len() as u64;
    let layers = cluster_layers(fixture, total).unwrap();
    let sentence = format!("Prefixes of {} bytes and more", layers[0].bytes);
    assert!(FORMAT.contains(&sentence), "FORMAT.md lacks '{sentence}'");
}
