use proptest::prelude::*;

use super::*;
use crate::chunk::container::VERSION;

fn stored(keys: &[ColumnKey]) -> Vec<u8> {
    let mut out = Vec::new();
    put_keys(&mut out, keys);
    assert!(out.len() as u64 <= keys_bytes_max(keys.len()));
    out
}

fn read(bytes: &[u8], count: usize) -> Result<Vec<ColumnKey>, ChunkError> {
    let mut reader = Reader::new("test", bytes);
    let keys = take_keys(&mut reader, count, VERSION)?;
    reader.end()?;
    Ok(keys)
}

fn sorted(mut keys: Vec<ColumnKey>) -> Vec<ColumnKey> {
    keys.sort_unstable();
    keys.dedup();
    keys
}

/// Keys of the patches and parts of the sky that columns read: what walks are of.
fn named(keys: &[ColumnKey]) -> Vec<ColumnKey> {
    sorted(keys.iter().map(|&key| PatchKey(key).patch().0).collect())
}

/// A wall of 32² patches of level 0 in direction `direction`, and around each 4² one of level 2.
fn wall(direction: u8) -> Vec<ColumnKey> {
    let cell = |level: u32, u: i32, v: i32| {
        let mut cell = [-1; 3];
        (cell[usize::from(direction / 2 + 1) % 3], cell[usize::from(direction / 2 + 2) % 3]) = (u, v);
        PatchKey::of_cell(level, cell, direction, 0).0
    };
    let fine = (-16..16).flat_map(|u| (-16..16).map(move |v| cell(0, u, v)));
    let coarse = (-4..4).flat_map(|u| (-4..4).map(move |v| cell(2, u, v)));
    sorted(fine.chain(coarse).collect())
}

#[test]
fn cut_of_a_flat_wall_takes_a_tenth_of_its_keys_and_the_same_in_every_direction() {
    let sub_cells: Vec<Vec<u8>> = (0..6)
        .map(|direction| {
            let keys = wall(direction);
            let bytes = stored(&keys);
            assert_eq!(bytes[0], WALK);
            assert!(10 * bytes.len() < 8 * keys.len(), "{} bytes of {} keys", bytes.len(), keys.len());
            assert_eq!(read(&bytes, keys.len()).unwrap(), keys);
            take_cells(&mut Reader::new("test", &bytes[1..]), keys.len())
                .unwrap()
                .into_iter()
                .map(|(_, sub_cells)| sub_cells)
                .collect()
        })
        .collect();
    assert!(sub_cells.iter().all(|of| *of == sub_cells[0]));
}

#[test]
fn keys_that_no_patch_has_are_stored_as_they_are() {
    for keys in [vec![], vec![3, u64::MAX], vec![6 << 55, 7 << 55], (0..99).map(|i| 6 << 55 | i).collect()] {
        let bytes = stored(&keys);
        assert_eq!((bytes[0], bytes.len()), (PLAIN, 1 + 8 * keys.len()));
        assert_eq!(read(&bytes, keys.len()).unwrap(), keys);
        let old = take_keys(&mut Reader::new("test", &bytes[1..]), keys.len(), LAST_WITHOUT_MODE);
        assert_eq!(old.unwrap(), keys);
    }
}

#[test]
fn broken_walks_are_refused_by_their_fault() {
    let keys = wall(3);
    let bytes = stored(&keys);
    for count in [0, 1, 63, 64, 700, keys.len() - 1] {
        assert!(read(&bytes, count).is_err(), "{count}");
    }
    assert!((0..bytes.len()).all(|length| read(&bytes[..length], keys.len()).is_err()));
    let refused = |highest: &[PatchKey], rest: &[u8]| {
        let mut bytes = vec![WALK, highest[0].level() as u8];
        put_highest(&mut bytes, highest.iter());
        bytes.extend_from_slice(rest);
        read(&bytes, 2).unwrap_err().to_string()
    };
    let cell = |level, x| PatchKey::of_cell(level, [x, 0, 0], 0, 0);
    // Sub-cells; codes; how many are listed, their numbers; parts of the sky.
    assert!(refused(&[cell(1, -8193)], &[1, 0, 0, 0, 0, 0]).contains("place of a divided cell"));
    assert!(refused(&[cell(1, 8192)], &[1, 0, 0, 0, 0, 0]).contains("place of a divided cell"));
    assert!(refused(&[cell(1, 0)], &[7]).contains("cells of a level"));
    assert!(refused(&[cell(0, 0); 2], &[]).contains("does not ascend"));
    assert!(refused(&[cell(0, 1), cell(0, 0)], &[]).contains("does not ascend"));
    assert!(refused(&[cell(0, 0)], &[LISTED, 1, 2, 0, 0]).contains("listed patches"));
    assert!(refused(&[cell(0, 0)], &[LISTED, 0, 2, 0, 4, 0]).contains("number of a patch"));
    assert!(refused(&[cell(0, 0)], &[0, 0, 0, 0, 0]).contains("left over"));
}

/// Cuts: each visited cell is named, divided or both, parts may be missing, and columns may be of differences.
fn cut(noise: &mut impl Iterator<Item = u8>, cell: PatchKey, keys: &mut Vec<ColumnKey>) {
    let draw = noise.next().unwrap_or_default();
    if draw & 1 == 1 {
        let ordinals = [&[0][..], &[1], &[0, 1], &[2, 1023]][usize::from(draw >> 1 & 3)];
        let column = |key: PatchKey| if draw & 16 == 16 { key.difference() } else { key };
        keys.extend(ordinals.iter().map(|ordinal| column(PatchKey(cell.0 + ordinal)).0));
    }
    if draw & 8 == 8 && cell.level() > 0 {
        let there = noise.next().unwrap_or_default();
        for number in (0..8).filter(|number| there >> number & 1 == 1) {
            cut(noise, sub_cell(cell, number), keys);
        }
    }
}

proptest! {
    #[test]
    fn cuts_come_back(
        roots in prop::collection::vec((0_u32..=14, prop::array::uniform3(-8192..8192), 0_u8..6), 0..4),
        noise in prop::collection::vec(any::<u8>(), 0..600),
        sky in prop::collection::vec(prop_oneof![0_u32..64, any::<u32>()], 0..9))
    {
        let mut keys: Vec<ColumnKey> = sky.into_iter().map(|part| PatchKey::of_sky(part).0).collect();
        let mut noise = noise.into_iter();
        for (level, cell, direction) in roots {
            cut(&mut noise, PatchKey::of_cell(level, cell, direction, 0), &mut keys);
        }
        let keys = sorted(keys);
        prop_assert_eq!(read(&stored(&keys), keys.len()).unwrap(), &keys[..]);
        // The walk comes back where keys as they are would be shorter too.
        let named = named(&keys);
        let walk = walk_of(&named).unwrap();
        prop_assert_eq!(take_walk(&mut Reader::new("test", &walk), named.len()).unwrap(), named);
    }

    #[test]
    fn any_keys_come_back(
        near in prop::collection::vec(any::<u64>(), 0..60), mask in any::<u64>(), bits in any::<u64>())
    {
        let keys = sorted(near.into_iter().map(|key| key & mask | bits).collect());
        prop_assert_eq!(read(&stored(&keys), keys.len()).unwrap(), &keys[..]);
        let named = named(&keys);
        if let Some(walk) = walk_of(&named) {
            prop_assert_eq!(take_walk(&mut Reader::new("test", &walk), named.len()).unwrap(), named);
        }
    }

    #[test]
    fn changed_walks_are_refused_or_are_ascending_keys(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..5), direction in 0_u8..6)
    {
        let keys = wall(direction);
        let mut bytes = stored(&keys);
        for (index, value) in changes {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(read) = read(&bytes, keys.len()) {
            prop_assert!(read.len() == keys.len() && read.is_sorted_by(|a, b| a < b));
        }
    }
}
