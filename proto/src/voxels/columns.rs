//! Elements of a level as the arrays of its sections.

use glam::IVec3;

use super::content::{BRICKS_MAX, Brick, BrickKey, Element, NormalCode, Voxel, voxel_in_brick};
use super::place::{Lattices, PatchPlace, Placed};
use super::predict::{NEW, Sheet, Sheets, bits_of_plane};
use crate::chunk::bytes::{Reader, put_u64s};
use crate::chunk::error::in_range;
use crate::chunk::{ChunkError, ints};
use crate::content::PatchKey;

/// Sections of a level.
pub(super) const SECTIONS: usize = 5;
/// Bytes of the mask of a brick's voxels.
const MASK_BYTES: usize = 64;

/// Flags of an element; the bits above them tell where its patch is.
mod flags {
    pub const BACKED: u8 = 1;
    pub const FINEST: u8 = 2;
    pub const GLOWS: u8 = 4;
    /// Bits below those of the patch's symbol.
    pub const COUNT: u32 = 4;
}

/// Marks of an element's bits.
mod marks {
    /// Some sub-voxels of the guess are not in it.
    pub const MISSING: u8 = 1;
    /// Some of its sub-voxels are not in the guess.
    pub const OTHERS: u8 = 2;
}

/// Counts of a level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LevelCounts {
    /// Level.
    pub level: u32,
    /// Bricks.
    pub bricks: usize,
    /// Voxels of all of them.
    pub voxels: usize,
    /// Elements of all these.
    pub elements: usize,
}

impl LevelCounts {
    /// Of bricks of one level.
    pub fn of(bricks: &[Brick]) -> Self {
        Self {
            level: bricks.first().map_or(0, |brick| brick.key.level),
            bricks: bricks.len(),
            voxels: bricks.iter().map(|brick| brick.voxels.len()).sum(),
            elements: bricks.iter().map(|brick| brick.elements.len()).sum(),
        }
    }

    /// Most bytes of each section.
    pub fn bytes_max(&self) -> [u64; SECTIONS] {
        let array = ints::bytes_max(self.elements);
        let bytes = self.elements as u64;
        [
            3 * ints::bytes_max(self.bricks)
                + (MASK_BYTES * self.bricks) as u64
                + ints::bytes_max(self.voxels),
            bytes + 2 * array,
            array,
            3 * bytes + 6 * array,
            17 * bytes,
        ]
    }

    /// Memory that decoding takes, about.
    pub fn decoded_bytes(&self) -> u64 {
        let of_brick = size_of::<Brick>() + MASK_BYTES + 16;
        let of_voxel = size_of::<Voxel>() + 8;
        let of_element = size_of::<Placed>() + size_of::<Element>() + size_of::<PatchPlace>();
        (of_brick * self.bricks + of_voxel * self.voxels + of_element * self.elements) as u64
    }
}

/// Elements of a brick, each with its voxel.
pub(super) fn placed(brick: &Brick) -> impl Iterator<Item = (IVec3, &Element)> {
    voxels_of(brick).zip(&brick.elements)
}

/// Voxels of a brick, each as often as it has elements.
fn voxels_of(brick: &Brick) -> impl Iterator<Item = IVec3> {
    let first = brick.key.first_voxel();
    brick.voxels.iter().flat_map(move |voxel| {
        std::iter::repeat_n(first + voxel_in_brick(voxel.place), usize::from(voxel.elements))
    })
}

/// The sections of a level's bricks, whose content is in order; `cells` cells of patches lie along a side of their level's voxels.
pub(super) fn write_level(bricks: &[Brick], cells: u32) -> [Vec<u8>; SECTIONS] {
    let level = LevelCounts::of(bricks).level;
    let in_level = bricks.iter().flat_map(placed);
    let placed: Vec<Placed> = in_level.map(|(voxel, &element)| Placed { voxel, element }).collect();
    let lattices = Lattices { level, cells };
    let of = |Placed { voxel, element }: &Placed| PatchPlace::of(element.patch, lattices, *voxel);
    let places: Vec<PatchPlace> = placed.iter().map(of).collect();
    let [normals, planes] = write_planes(&placed);
    [write_bricks(bricks), normals, planes, write_patches(&placed, &places), write_bits(&placed, &places)]
}

/// Reads a level's bricks; the caller has checked the counts.
pub(super) fn read_level(
    counts: LevelCounts,
    sections: &[Vec<u8>; SECTIONS],
    cells: u32,
) -> Result<Vec<Brick>, ChunkError> {
    let [in_bricks, normals, planes, patches, bits] = sections;
    let mut bricks = read_bricks(in_bricks, counts)?;
    let empty = Element {
        normal: NormalCode::default(),
        plane: 0,
        bits: 0,
        patch: None,
        glow: 0,
        is_backed: false,
        is_finest: false,
    };
    let mut all: Vec<Placed> = Vec::with_capacity(counts.elements);
    all.extend(bricks.iter().flat_map(voxels_of).map(|voxel| Placed { voxel, element: empty }));
    read_planes(normals, planes, &mut all)?;
    let places = read_patches(patches, &mut all, Lattices { level: counts.level, cells })?;
    read_bits(bits, &mut all, &places)?;
    let mut elements = all.into_iter().map(|placed| placed.element);
    for brick in &mut bricks {
        let count = brick.voxels.iter().map(|voxel| usize::from(voxel.elements)).sum();
        brick.elements = elements.by_ref().take(count).collect();
    }
    Ok(bricks)
}

fn write_bricks(bricks: &[Brick]) -> Vec<u8> {
    let mut out = Vec::new();
    for axis in [2, 1, 0] {
        ints::put_deltas(&mut out, bricks.iter().map(|brick| brick.key.cell()[axis]));
    }
    for brick in bricks {
        let mut mask = [0_u8; MASK_BYTES];
        for voxel in &brick.voxels {
            mask[usize::from(voxel.place / 8)] |= 1 << (voxel.place % 8);
        }
        out.extend_from_slice(&mask);
    }
    let voxels = bricks.iter().flat_map(|brick| &brick.voxels);
    ints::put_u32s(&mut out, &voxels.map(|voxel| u32::from(voxel.elements) - 1).collect::<Vec<_>>());
    out
}

/// Bricks without their elements.
fn read_bricks(raw: &[u8], counts: LevelCounts) -> Result<Vec<Brick>, ChunkError> {
    let LevelCounts { level, bricks: count, voxels, elements } = counts;
    let mut reader = Reader::new("bricks", raw);
    let mut cells = vec![IVec3::ZERO; count];
    for axis in [2, 1, 0] {
        let along = ints::take_deltas(&mut reader, "cell", count, -BRICKS_MAX..=BRICKS_MAX)?;
        cells.iter_mut().zip(along).for_each(|(cell, at)| cell[axis] = at);
    }
    let masks = reader.take("masks", count, MASK_BYTES)?;
    let set: u64 = masks.iter().map(|byte| u64::from(byte.count_ones())).sum();
    in_range("bricks", "voxels in masks", set, voxels as u64, voxels as u64)?;
    let more = ints::take_u32s(&mut reader, "elements of voxels", voxels)?;
    reader.end()?;
    let mut all = 0;
    for &more in &more {
        all += in_range("bricks", "elements of a voxel", u64::from(more) + 1, 1, u16::MAX.into())? as u64;
    }
    in_range("bricks", "elements of all voxels", all, elements as u64, elements as u64)?;
    let mut more = more.into_iter();
    let brick = |(cell, mask): (IVec3, &[u8])| {
        let is_set = |place: &u16| mask[usize::from(place / 8)] >> (place % 8) & 1 == 1;
        let mut voxels = Vec::with_capacity(mask.iter().map(|byte| byte.count_ones() as usize).sum());
        let filled = (0..8 * MASK_BYTES as u16).filter(is_set).zip(more.by_ref());
        voxels.extend(filled.map(|(place, more)| Voxel { place, elements: more as u16 + 1 }));
        Brick { key: BrickKey::new(level, cell), voxels, elements: Vec::new() }
    };
    Ok(cells.into_iter().zip(masks.chunks_exact(MASK_BYTES)).map(brick).collect())
}

/// Normals, and errors of guessed planes.
fn write_planes(placed: &[Placed]) -> [Vec<u8>; 2] {
    let mut sheets = Sheets::default();
    let (mut numbers, mut errors) = (Vec::new(), Vec::new());
    let mut steps = [Vec::new(), Vec::new()];
    for &Placed { voxel, element: Element { normal, plane, .. } } in placed {
        let sheet = Sheet { normal, plane, voxel };
        let number = sheets.number_of(&sheet);
        if number == NEW {
            let before = sheets.last_normal();
            for (axis, steps) in steps.iter_mut().enumerate() {
                steps.push(normal.0[axis].wrapping_sub(before.0[axis]).into());
            }
        }
        let error = plane.wrapping_sub(sheets.guess(number, normal, voxel));
        sheets.note(number, error, sheet);
        numbers.push(number as u8);
        errors.push(error.into());
    }
    let (mut normals, mut planes) = (numbers, Vec::new());
    steps.iter().for_each(|steps| ints::put_i32s(&mut normals, steps));
    ints::put_i32s(&mut planes, &errors);
    [normals, planes]
}

fn read_planes(normals: &[u8], planes: &[u8], placed: &mut [Placed]) -> Result<(), ChunkError> {
    let mut reader = Reader::new("normals", normals);
    let numbers = reader.take("sheet", placed.len(), 1)?;
    let new = numbers.iter().filter(|&&number| usize::from(number) == NEW).count();
    let u = ints::take_i32s(&mut reader, "normal", new)?;
    let v = ints::take_i32s(&mut reader, "normal", new)?;
    reader.end()?;
    let mut steps = u.into_iter().zip(v);
    let mut reader = Reader::new("planes", planes);
    let errors = ints::take_i32s(&mut reader, "plane", placed.len())?;
    reader.end()?;
    let mut sheets = Sheets::default();
    for ((Placed { voxel, element }, &number), error) in placed.iter_mut().zip(numbers).zip(errors) {
        let number = usize::from(number);
        element.normal = match sheets.normal(number) {
            Some(normal) => normal,
            None if number == NEW => stepped(sheets.last_normal(), steps.next().unwrap_or_default())?,
            None => return Err(sheets.unknown(number)),
        };
        let error = short("planes", "plane", error)?;
        element.plane = sheets.guess(number, element.normal, *voxel).wrapping_add(error);
        sheets.note(number, error, Sheet { normal: element.normal, plane: element.plane, voxel: *voxel });
    }
    Ok(())
}

fn stepped(before: NormalCode, (u, v): (i32, i32)) -> Result<NormalCode, ChunkError> {
    let mut code = before.0;
    for (at, step) in code.iter_mut().zip([u, v]) {
        *at = at.wrapping_add(short("normals", "normal", step)?);
    }
    Ok(NormalCode(code))
}

/// A number of 16 bits.
fn short(section: &'static str, what: &'static str, value: i32) -> Result<i16, ChunkError> {
    let (min, max) = (0, i16::MAX as u64);
    let error = |_| ChunkError::OutOfRange { section, what, value: value.unsigned_abs().into(), min, max };
    i16::try_from(value).map_err(error)
}

fn write_patches(placed: &[Placed], places: &[PatchPlace]) -> Vec<u8> {
    let mut out = Vec::new();
    let flag = |is_set: bool, flag: u8| if is_set { flag } else { 0 };
    for (Placed { element, .. }, place) in placed.iter().zip(places) {
        let flags = flag(element.is_backed, flags::BACKED)
            | flag(element.is_finest, flags::FINEST)
            | flag(element.glow > 0, flags::GLOWS);
        out.push(flags | place.symbol() << flags::COUNT);
    }
    PatchPlace::write(places, placed, &mut out);
    let ordinals = placed.iter().filter_map(|placed| placed.element.patch).map(PatchKey::ordinal);
    ints::put_u32s(&mut out, &ordinals.collect::<Vec<_>>());
    let glows = placed.iter().map(|placed| placed.element.glow).filter(|&glow| glow > 0);
    ints::put_u32s(&mut out, &glows.map(|glow| u32::from(glow) - 1).collect::<Vec<_>>());
    out
}

/// Reads flags, patches and glows, and gives the places of patches.
fn read_patches(
    raw: &[u8],
    placed: &mut [Placed],
    lattices: Lattices,
) -> Result<Vec<PatchPlace>, ChunkError> {
    let mut reader = Reader::new("patches", raw);
    let flags = reader.take("flags", placed.len(), 1)?;
    let symbols: Vec<u8> = flags.iter().map(|flags| flags >> flags::COUNT).collect();
    let places = PatchPlace::read(&mut reader, &symbols, placed, lattices)?;
    let patched = symbols.iter().filter(|&&symbol| symbol != 0).count();
    let mut ordinals = ints::take_u32s(&mut reader, "ordinal", patched)?.into_iter();
    let glowing = flags.iter().filter(|&flags| flags & flags::GLOWS != 0).count();
    let mut glows = ints::take_u32s(&mut reader, "glow", glowing)?.into_iter();
    reader.end()?;
    let known = flags::BACKED | flags::FINEST | flags::GLOWS | u8::MAX << flags::COUNT;
    for ((Placed { voxel, element }, place), &flags) in placed.iter_mut().zip(&places).zip(flags) {
        in_range("patches", "flags that are not known", u64::from(flags & !known), 0, 0)?;
        element.is_backed = flags & flags::BACKED != 0;
        element.is_finest = flags & flags::FINEST != 0;
        element.patch = place.key(lattices, *voxel, || ordinals.next().unwrap_or_default())?;
        if flags & flags::GLOWS != 0 {
            let glow = u64::from(glows.next().unwrap_or_default());
            element.glow = in_range("patches", "glow", glow, 0, u64::from(u16::MAX) - 1)? as u16 + 1;
        }
    }
    Ok(places)
}

/// Guesses of bits, by plane and patch.
fn guessed_bits(placed: &[Placed], places: &[PatchPlace]) -> Vec<u64> {
    let guess = |(Placed { element, .. }, place): (&Placed, &PatchPlace)| {
        bits_of_plane(element.normal, element.plane) & place.bits()
    };
    placed.iter().zip(places).map(guess).collect()
}

/// Sub-voxels of some bits, ascending.
fn subs_of(mut bits: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let sub = bits.trailing_zeros();
        bits &= bits.wrapping_sub(1);
        (sub < u64::BITS).then_some(sub)
    })
}

fn write_bits(placed: &[Placed], places: &[PatchPlace]) -> Vec<u8> {
    let (mut marks, mut missing, mut others) = (Vec::new(), Vec::new(), Vec::new());
    let mut count = 0;
    for (guess, Placed { element, .. }) in guessed_bits(placed, places).into_iter().zip(placed) {
        let mut mark = 0;
        if guess & !element.bits != 0 {
            mark |= marks::MISSING;
            for sub in subs_of(guess) {
                if count % 8 == 0 {
                    missing.push(0);
                }
                missing[count / 8] |= u8::from(element.bits >> sub & 1 == 0) << (count % 8);
                count += 1;
            }
        }
        if element.bits & !guess != 0 {
            mark |= marks::OTHERS;
            others.push(element.bits & !guess);
        }
        marks.push(mark);
    }
    marks.append(&mut missing);
    put_u64s(&mut marks, &others);
    marks
}

fn read_bits(raw: &[u8], placed: &mut [Placed], places: &[PatchPlace]) -> Result<(), ChunkError> {
    let guesses = guessed_bits(placed, places);
    let mut reader = Reader::new("bits", raw);
    let marks = reader.take("marks", placed.len(), 1)?;
    let is_missing =
        |(mark, guess): (&u8, &u64)| (mark & marks::MISSING != 0).then(|| guess.count_ones() as usize);
    let subs: usize = marks.iter().zip(&guesses).filter_map(is_missing).sum();
    let missing = reader.take("missing sub-voxels", subs.div_ceil(8), 1)?;
    let with_others = marks.iter().filter(|&mark| mark & marks::OTHERS != 0).count();
    let mut others = reader.u64s("other sub-voxels", with_others)?.into_iter();
    reader.end()?;
    let mut count = 0;
    for ((Placed { element, .. }, guess), &mark) in placed.iter_mut().zip(guesses).zip(marks) {
        in_range("bits", "mark", mark.into(), 0, u64::from(marks::MISSING | marks::OTHERS))?;
        element.bits = guess;
        if mark & marks::MISSING != 0 {
            for sub in subs_of(guess) {
                element.bits &= !(u64::from(missing[count / 8] >> (count % 8) & 1) << sub);
                count += 1;
            }
        }
        if mark & marks::OTHERS != 0 {
            element.bits |= others.next().unwrap_or_default();
        }
    }
    Ok(())
}
