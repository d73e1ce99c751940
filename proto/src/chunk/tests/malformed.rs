//! Malformed input is an error: never a panic, never a large allocation, never a wrong shape.

use proptest::prelude::*;

use super::scenes::{batch, directory, field, narrow, patches, quads, tetrahedra, transfer, voxels, wall};
use super::whole::{
    assert_batch, assert_directory, assert_field, assert_geometry, assert_patches, assert_tetrahedra,
    assert_transfer, assert_voxels, assert_whole,
};
use crate::chunk::container::{Container, ContainerWriter, SectionId};
use crate::chunk::*;
use crate::content::*;
use crate::kinds::field::{
    FIELD_CHUNK, MESH, decode_field, decode_tetrahedra, encode_field, encode_tetrahedra,
};
use crate::kinds::sh::*;
use crate::transfer::{TRANSFER_CHUNK, decode_transfer, encode_transfer};
use crate::voxels::{VOXELS_CHUNK, decode_voxels, decode_voxels_prefix, encode_voxels};

/// A chunk of each kind, small enough to be cut at every byte.
fn chunks() -> Vec<(ChunkKind, Vec<u8>)> {
    vec![
        (CLUSTER, encode_cluster(&wall(8, 3, 3, 9, 1), QuantisationSettings::default()).unwrap().bytes),
        (PROBES_CHUNK, encode_probe_batch(&batch(3, 16, 2)).unwrap()),
        (GEOMETRY, encode_geometry(&quads()).unwrap()),
        (PATCHES, encode_patches(&patches(3)).unwrap()),
        (DIRECTORY, encode_directory(&directory(5).0, &directory(5).1).unwrap()),
        (TEXTURE, encode_texture("image/jpeg", &[7; 300]).unwrap()),
        (CLUSTER, encode_cluster(&narrow(8, 1), QuantisationSettings::default()).unwrap().bytes),
        (FIELD_CHUNK, encode_field(&field(2, 3, 1), 0.01).unwrap().bytes),
        (MESH, encode_tetrahedra(&tetrahedra(9)).unwrap()),
        (VOXELS_CHUNK, encode_voxels(&voxels(2, 1)).unwrap()),
        (TRANSFER_CHUNK, encode_transfer(&transfer(4)).unwrap()),
    ]
}

/// Decodes as any kind; decoded content must be of one piece.
fn decode(kind: ChunkKind, bytes: &[u8]) -> Result<(), ChunkError> {
    match kind {
        CLUSTER => {
            let layers = cluster_layers(bytes, bytes.len() as u64);
            let cluster = decode_cluster(bytes)?;
            assert_whole(&cluster);
            assert_eq!(layers?.last().map(|layer| layer.bytes), Some(bytes.len() as u64));
            Ok(())
        }
        PROBES_CHUNK => decode_probe_batch(bytes).map(|batch| assert_batch(&batch)),
        GEOMETRY => decode_geometry(bytes).map(|geometry| assert_geometry(&geometry)),
        PATCHES => decode_patches(bytes).map(|set| assert_patches(&set)),
        DIRECTORY => decode_directory(bytes).map(|(rows, chunks)| assert_directory(&rows, &chunks)),
        TEXTURE => decode_texture(bytes).map(drop),
        FIELD_CHUNK => decode_field(bytes).map(|part| assert_field(&part)),
        MESH => decode_tetrahedra(bytes).map(|set| assert_tetrahedra(&set)),
        VOXELS_CHUNK => decode_voxels(bytes).map(|part| assert_voxels(&part)),
        TRANSFER_CHUNK => decode_transfer(bytes).map(|level| assert_transfer(&level)),
        kind => unreachable!("{kind:?} is not among the chunks"),
    }
}

/// The chunk with its sections unpacked, changed by `change(index, raw)`, and packed again.
fn repacked(kind: ChunkKind, bytes: &[u8], mut change: impl FnMut(usize, &mut Vec<u8>)) -> Vec<u8> {
    let container = Container::whole(kind, bytes).unwrap();
    let mut writer = ContainerWriter::new(kind);
    for (index, entry) in container.entries.iter().enumerate() {
        let mut raw = container.section(index, "test", u64::MAX).unwrap();
        change(index, &mut raw);
        writer.push(entry.id, &raw).unwrap();
    }
    writer.finish(container.head).unwrap().0
}

#[test]
fn a_chunk_cut_at_any_length_is_refused() {
    for (kind, bytes) in chunks() {
        decode(kind, &bytes).unwrap();
        for length in 0..bytes.len() {
            assert!(decode(kind, &bytes[..length]).is_err(), "{kind:?} of {length} bytes");
        }
        let longer = [&bytes[..], &[0]].concat();
        assert!(decode(kind, &longer).is_err(), "{kind:?} with a byte too many");
    }
}

#[test]
fn a_chunk_of_another_kind_version_or_magic_is_refused_by_name() {
    for (kind, bytes) in chunks() {
        let changed = |offset: usize| {
            let mut bytes = bytes.clone();
            bytes[offset] ^= 0x40;
            decode(kind, &bytes).unwrap_err()
        };
        assert!(matches!(changed(0), ChunkError::Magic { .. }));
        assert!(matches!(changed(4), ChunkError::Version { .. }));
        assert!(matches!(changed(6), ChunkError::Kind { .. }));
    }
}

#[test]
fn oversized_counts_and_lengths_are_refused() {
    for (kind, bytes) in chunks() {
        let container = Container::whole(kind, &bytes).unwrap();
        let table_end = HEADER_BYTES + container.head.len() + ENTRY_BYTES * container.entries.len();
        for offset in 8..table_end - 3 {
            for value in [u32::MAX, i32::MAX as u32, 1 << 24, 0x0001_0001] {
                let mut bytes = bytes.clone();
                bytes[offset..offset + 4].copy_from_slice(&value.to_le_bytes());
                // Bounds of a cluster and a media type may be anything; all else must be noticed or harmless.
                let _ = decode(kind, &bytes);
            }
        }
    }
    let mut bytes = chunks().remove(0).1;
    bytes[HEADER_BYTES + 24..HEADER_BYTES + 28].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(
        matches!(decode_cluster(&bytes), Err(ChunkError::OutOfRange { value, .. }) if value >= u64::from(u32::MAX))
    );
}

/// Counts of 0 where none may be: a layer of no sections once made the reader of the layers panic.
#[test]
fn a_byte_that_is_zeroed_ahead_of_the_sections_does_no_harm() {
    for (kind, mut bytes) in chunks() {
        let container = Container::whole(kind, &bytes).unwrap();
        let sections = HEADER_BYTES + container.head.len() + ENTRY_BYTES * container.entries.len();
        for place in 0..sections {
            let byte = std::mem::take(&mut bytes[place]);
            let _ = decode(kind, &bytes);
            bytes[place] = byte;
        }
    }
}

#[test]
fn decompression_bomb_is_refused_before_it_goes_off() {
    let is_bounded = |kind| !matches!(kind, PATCHES | TEXTURE);
    for (kind, bytes) in chunks().into_iter().filter(|(kind, _)| is_bounded(*kind)) {
        let count = Container::whole(kind, &bytes).unwrap().entries.len();
        for bomb in 0..count {
            let bytes = repacked(kind, &bytes, |index, raw| {
                if index == bomb {
                    *raw = vec![0; 8 << 20];
                }
            });
            assert!(bytes.len() < 16 << 10, "the bomb is small: {} bytes", bytes.len());
            let error = decode(kind, &bytes).unwrap_err();
            assert!(matches!(error, ChunkError::OutOfRange { what: "raw length", .. }), "{error}");
        }
    }
}

#[test]
fn file_that_a_small_chunk_cannot_hold_is_refused_by_decoder_and_encoder() {
    let file = vec![0; 64 << 20];
    let mut writer = ContainerWriter::new(TEXTURE);
    writer.push(SectionId::new(1, [0; 3]), &file).unwrap();
    let (bytes, _) = writer.finish(b"image/png").unwrap();
    for error in [decode_texture(&bytes).unwrap_err(), encode_texture("image/png", &file).unwrap_err()] {
        assert!(matches!(error, ChunkError::OutOfRange { what: "decoded bytes", .. }), "{error}");
    }
}

#[test]
fn a_frame_longer_than_its_declared_length_is_refused() {
    let mut writer = ContainerWriter::new(TEXTURE);
    writer.push(SectionId::new(1, [0; 3]), &[0; 1 << 20]).unwrap();
    let (mut bytes, _) = writer.finish(b"image/png").unwrap();
    let raw_length = HEADER_BYTES + 9 + 8;
    bytes[raw_length..raw_length + 4].copy_from_slice(&100_u32.to_le_bytes());
    assert!(matches!(decode_texture(&bytes), Err(ChunkError::Compression { raw_bytes: 100, .. })));
}

#[test]
fn counts_that_would_swell_a_small_chunk_are_refused() {
    let (_, bytes) = chunks().remove(2);
    let mut head = Vec::new();
    for count in [1_u32, limits::VERTICES_MAX as u32, 0] {
        head.extend_from_slice(&count.to_le_bytes());
    }
    let container = Container::whole(GEOMETRY, &bytes).unwrap();
    let mut writer = ContainerWriter::new(GEOMETRY);
    for entry in &container.entries {
        // Widths of 0: every array claims to be all zeros.
        writer.push(entry.id, &[0; 5]).unwrap();
    }
    let (bytes, _) = writer.finish(&head).unwrap();
    let error = decode_geometry(&bytes).unwrap_err();
    assert!(matches!(error, ChunkError::OutOfRange { what: "decoded bytes", .. }), "{error}");
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let mut cluster = wall(8, 3, 3, 9, 1);
    cluster.factors.vt[5] = f32::INFINITY;
    assert!(encode_cluster(&cluster, QuantisationSettings::default()).is_err());
    let mut geometry = quads();
    geometry.draws[0].position_m[1][2] = f32::NAN;
    assert!(encode_geometry(&geometry).is_err());
    let (kind, bytes) = chunks().remove(1);
    // The base section of probes ends with the radii.
    let bytes = repacked(kind, &bytes, |index, raw| {
        if index == 0 {
            let end = raw.len() - 4;
            raw[end..].copy_from_slice(&f32::NAN.to_le_bytes());
        }
    });
    assert!(matches!(decode_probe_batch(&bytes), Err(ChunkError::BadNumber { .. })));
}

#[test]
fn keys_that_are_no_patchs_are_refused() {
    for (key, told) in [
        (PatchKey::of_sky(0), "level"),
        (PatchKey(PatchKey::of_cell(14, [0; 3], 5, 0).0 + (1 << 60)), "level"),
        (PatchKey(PatchKey::of_cell(1, [0; 3], 5, 0).0 + (1 << 55)), "direction"),
    ] {
        let mut set = patches(2);
        set.patches[0].key = key;
        assert!(encode_patches(&set).unwrap_err().to_string().contains(told), "{key:?}");
    }
    let stray = PatchKey(PatchKey::of_sky(7).0 | 1 << 40);
    assert_eq!((PatchKey::of_sky(7).sky(), stray.sky()), (Some(7), None));
}

#[test]
fn bounds_that_are_inside_out_are_refused() {
    let (_, mut bytes) = chunks().remove(0);
    // The head begins with the lower corner.
    bytes[HEADER_BYTES + 4..HEADER_BYTES + 8].copy_from_slice(&1e9_f32.to_le_bytes());
    assert!(matches!(decode_cluster(&bytes), Err(ChunkError::Order { index: 1, .. })));
}

#[test]
fn digest_of_other_bytes_is_noticed() {
    let (_, bytes) = chunks().remove(0);
    let digest = crate::ids::Digest::of(&bytes);
    assert!(verify(digest, &bytes).is_ok());
    assert!(matches!(verify(digest, &bytes[1..]), Err(ChunkError::Digest { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    #[test]
    fn flipped_bits_never_panic(flips in prop::collection::vec((any::<prop::sample::Index>(), 0_u32..8), 1..6)) {
        for (kind, mut bytes) in chunks() {
            for (index, bit) in &flips {
                let at = index.index(bytes.len());
                bytes[at] ^= 1 << bit;
            }
            let _ = decode(kind, &bytes);
            let _ = decode_cluster_prefix(&bytes, bytes.len() as u64 + 100);
            let _ = decode_voxels_prefix(&bytes, bytes.len() as u64 + 100);
        }
    }

    #[test]
    fn flipped_bits_inside_sections_never_panic(
        flips in prop::collection::vec((0_usize..40, any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in 0_usize..3,
    ) {
        for (kind, bytes) in chunks() {
            let bytes = repacked(kind, &bytes, |section, raw| {
                for (target, index, value) in flips.iter().filter(|flip| flip.0 == section) {
                    if !raw.is_empty() {
                        let at = index.index(raw.len());
                        raw[at] = *value;
                        raw.truncate(raw.len() - (target % 3 * cut).min(raw.len()));
                    }
                }
            });
            let _ = decode(kind, &bytes);
        }
    }

    #[test]
    fn garbage_never_panics(garbage in prop::collection::vec(any::<u8>(), 0..400), keep in 0_usize..200) {
        for (kind, bytes) in chunks() {
            prop_assert!(decode(kind, &garbage).is_err());
            let keep = keep.min(bytes.len());
            let _ = decode(kind, &[&bytes[..keep], &garbage].concat());
        }
    }
}
