//! A picture of an edit before it is baked.
//!
//! Receivers that are where they were, and near which nothing has changed, keep their rows of the bake's factors, and get what has changed for
//! them from walks: with W the irradiance (36) of the ends of a receiver's walks,
//!
//! ```text
//! E_ind = U·b + N + W(now) − W(before)
//! ```
//! Of patches that are others now factors read their parts, and of those that are gone the patches that they were part of. Ends of before have the light of the patches that the receiver's columns
//! tell apart, which may be coarse: so what the factors bring of them is taken away.
//! The directions are the same before and after, so that only those count which end elsewhere: where none does, the light is the bake's. All
//! other receivers have W alone. Bakes without voxels have no walks before: a cluster is kept as a whole where nothing has changed between it
//! and the patches and parts of the sky that it reads.

mod changes;
mod parts;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;

use glam::{IVec3, Vec3};
use lightkiln_proto::chunk;
use lightkiln_proto::content::{
    BlockKey, ClusterTransport, EmitterIrradiance, NearSurface, PatchKey, PatchSet, Texel,
};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::kinds::voxels;
use lightkiln_proto::manifest::{CLUSTERS, Manifest, Material, TEXTURES, TextureUse};
use lightkiln_proto::relight::{Ends, Inconsistent, PatchTable, WalkedTable};
use lightkiln_proto::voxels::{IRRADIANCE_WALKS, VOXELS, WALK_WEIGHT, walked, walked_blocks};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use self::changes::{Bounds, Changes};
use self::parts::{Parts, parts_of};
use super::only::{names, only, rename_columns};
use crate::bake::{Edited, LoadedBake, QuickBake};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;
use crate::threads::Threads;

/// Whether something of the patch itself is left.
type IsOwn = bool;
/// A receiver by name.
type Name = (BlockKey, Texel);

/// Reach of walls that cut texels, in texels; near hits may lie farther.
const NEAR_TEXELS: f32 = 3.0;
/// A receiver that moved no farther than such a share of a texel is where it was: clusters store places by numbers of their own.
const MOVED_TEXELS: f32 = 1.0 / 64.0;
/// Least cosine between its normals then.
const TURNED_COSINE: f32 = 0.999;
/// Half width of a part of the sky at a distance of 1.
const SKY_WIDTH: f32 = 0.25;

/// The bake of an edited scene that [`edited`] needs: receivers and patches as this bake has them, and voxels.
pub(super) fn quick(manifest: &Manifest) -> Result<QuickBake> {
    let own = manifest.settings.as_object().cloned().unwrap_or_default();
    let known: HashSet<&str> = voxels::Settings::rows().iter().map(|row| row.name).collect();
    let is_known = |name: &str| known.contains(name) && name != "cluster_receivers";
    let mut settings: Map<String, Value> = own.into_iter().filter(|(name, _)| is_known(name)).collect();
    settings.insert("texel_m".to_owned(), json!(manifest.layout()?.texel_m));
    Ok(QuickBake { kind: voxels::NAME, settings: Value::Object(settings) })
}

/// A bake with its parts decoded.
struct Opened {
    scene: LoadedScene,
    clusters: Vec<ClusterTransport>,
    patches: PatchSet,
    light: LightmapLight<PatchTable>,
}

impl Opened {
    fn fetch(source: &Source) -> Result<Self> {
        let (_, manifest) = source.manifest()?;
        let clusters = decoded(source, &manifest, CLUSTERS, |bytes| Ok(chunk::decode_cluster(bytes)?))?;
        let mut patches = decoded(source, &manifest, PATCHES, |bytes| Ok(chunk::decode_patches(bytes)?))?;
        let patches = patches.pop().ok_or_else(|| {
            ClientError::inconsistent(PATCHES, "are missing, which light comes from".to_owned())
        })?;
        let scene = LoadedScene::fetch(source, manifest)?;
        let mut light = LightmapLight::assemble(&scene, &clusters, |slots| PatchTable::new(&patches, slots))?;
        light.voxels = super::voxels(source, &scene.manifest, &light.transport.columns)?;
        Ok(Self { scene, clusters, patches, light })
    }

    /// By patch: what it is in another bake, or of one of which nothing is left what that is which it was part of.
    fn parts_in(&self, other: &Self) -> Vec<(Parts, IsOwn)> {
        let of = parts_of(&self.patches, &other.patches, &other.light.transport.columns);
        let rows = &self.light.transport.columns.patches;
        let found = |patch: u32| {
            let whole = |at: &u32| rows.get(*at as usize).map(|row| row.parent);
            let mut wholes =
                std::iter::successors(Some(patch), whole).map_while(|at| Some((at, of.get(at as usize)?)));
            let (at, parts) = wholes.find(|(_, parts)| !parts.is_empty())?;
            Some((parts.clone(), at == patch))
        };
        (0..of.len() as u32).map(|patch| found(patch).unwrap_or_default()).collect()
    }

    /// Ends of the walks of the receivers of another bake, as places in this one's λ, ascending; `None` of a bake without voxels.
    fn ends_of(&self, other: &Self) -> Option<HashMap<Name, Vec<u32>>> {
        let elements = self.light.voxels.as_ref()?;
        let columns = &self.light.transport.columns;
        let ends = walked(elements, columns, &other.light.transport.receivers, |_| true, &Threads);
        Some(other.clusters.iter().flat_map(names).zip(ends).map(|(name, ends)| (name, ends.added)).collect())
    }

    /// Key of a patch.
    fn key(&self, patch: u32) -> Option<PatchKey> {
        self.patches.patches.get(patch as usize).map(|patch| patch.key)
    }

    /// Place in λ of the sky's first part.
    fn first_of_sky(&self) -> u32 {
        2 * self.patches.patches.len() as u32
    }

    /// Columns that together read the radiance of some patches less that of others, with their factors.
    fn difference(&self, parts: &Parts, wholes: &Parts) -> Vec<(PatchKey, f32)> {
        let rows = &self.light.transport.columns.patches;
        if let ([(part, _)], [(whole, _)]) = (&parts[..], &wholes[..]) {
            let parent = rows.get(*part as usize).map(|row| row.parent);
            if parent == Some(*whole) {
                return self.key(*part).map(|key| (key.difference(), 1.0)).into_iter().collect();
            }
        }
        let mut all: BTreeMap<u32, f32> = BTreeMap::new();
        parts.iter().for_each(|(patch, share)| *all.entry(*patch).or_default() += share);
        wholes.iter().for_each(|(patch, share)| *all.entry(*patch).or_default() -= share);
        let of = |(patch, share): (u32, f32)| Some((self.key(patch)?, share));
        all.into_iter().filter(|(_, share)| *share != 0.0).filter_map(of).collect()
    }
}

/// The part of a cluster that is right still.
struct Kept {
    cluster: ClusterTransport,
    /// Patches of before that it has columns of.
    read: HashSet<u32>,
}

/// A receiver of the edited scene.
struct Receiver {
    position_m: Vec3,
    normal: Vec3,
    albedo: [f32; 3],
    /// E_emit of each emitter that shines on it.
    emitters: Vec<(u16, [f32; 3])>,
}

/// Everything that says what is left of the bake of before.
struct Comparison<'a> {
    changes: Changes,
    before: &'a Opened,
    after: &'a Opened,
    /// As [`Opened::parts_in`].
    parts: Vec<(Parts, IsOwn)>,
    receivers: HashMap<Name, Receiver>,
    blocks: HashSet<BlockKey>,
    /// Blocks whose light before is that of walks.
    walked: HashSet<BlockKey>,
    /// Materials have other colours, which hits on surfaces without texels keep.
    has_other_colours: bool,
    /// Columns are compared, not walks.
    by_columns: bool,
    texel_m: f32,
}

/// The light of an edited scene: `before` is the bake of the scene as it was, `after` that of [`quick`].
pub(super) fn edited(before: &Source, after: &Source) -> Result<Edited> {
    let (was, is) = (Opened::fetch(before)?, Opened::fetch(after)?);
    let same_voxels = |of: &Opened| of.light.voxels.as_ref().map(|table| table.voxel_m);
    let has_walks = same_voxels(&was).is_some() && same_voxels(&was) == same_voxels(&is);
    let ends_before = if has_walks { was.ends_of(&is) } else { None };
    let ends_now = is.ends_of(&is).ok_or_else(|| {
        ClientError::inconsistent(VOXELS, "are missing, which the light of an edit comes from".to_owned())
    })?;
    let comparison = Comparison {
        changes: Changes::between(&was.scene, &is.scene),
        receivers: receivers(&is.clusters),
        blocks: is.scene.lightmap.blocks.iter().map(|block| block.key).collect(),
        walked: walked_blocks(&was.scene.manifest).keys().collect(),
        has_other_colours: colours(&was.scene.manifest) != colours(&is.scene.manifest),
        by_columns: ends_before.is_none(),
        texel_m: is.scene.manifest.layout()?.texel_m,
        before: &was,
        after: &is,
        parts: was.parts_in(&is),
    };
    let (mut contents, mut read) = (Vec::new(), Vec::new());
    let left: Vec<Option<Kept>> = was.clusters.par_iter().map(|cluster| comparison.kept(cluster)).collect();
    for of in left.into_iter().flatten() {
        contents.push(of.cluster);
        read.push(of.read);
    }
    let kept: HashSet<Name> = contents.iter().flat_map(names).collect();
    contents.extend(is.clusters.iter().filter_map(|cluster| only(cluster, |name| !kept.contains(&name))));
    let mut light =
        LightmapLight::assemble(&is.scene, &contents, |slots| PatchTable::new(&is.patches, slots))?;
    let (mut all, mut provisional) = (Vec::new(), Vec::new());
    let slots = contents
        .iter()
        .enumerate()
        .flat_map(|(index, cluster)| names(cluster).map(move |name| (index, name)));
    for (slot, (cluster, name)) in (0..).zip(slots) {
        let now = ends_now.get(&name).map_or(&[][..], Vec::as_slice);
        let ends = match (read.get(cluster), &ends_before) {
            (None, _) => Ends { slot, added: now.to_vec(), taken: Vec::new() },
            (Some(_), None) => Ends::default(),
            (Some(read), Some(before)) => {
                let before = before.get(&name).map_or(&[][..], Vec::as_slice);
                comparison.difference(slot, (before, now), read)
            }
        };
        let changed = |ends: &Ends| ends.added.len().max(ends.taken.len()) as f32 / IRRADIANCE_WALKS as f32;
        provisional.push(match (&ends_before, comparison.walked.contains(&name.0)) {
            _ if cluster < read.len() => changed(&ends),
            // The bake's own light is that of walks.
            (Some(before), true) => {
                let before = before.get(&name).map_or(&[][..], Vec::as_slice);
                changed(&comparison.difference(slot, (before, now), &HashSet::new()))
            }
            _ => 1.0,
        });
        all.extend((!ends.is_empty()).then_some(ends));
    }
    light.transport.walked = WalkedTable::new(all, WALK_WEIGHT, &light.transport.near)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    light.voxels = is.light.voxels;
    Ok(Edited { bake: LoadedBake::new(is.scene, Box::new(light)), provisional })
}

/// The part with the greatest share.
fn most(parts: &Parts) -> Option<u32> {
    parts.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(part, _)| *part)
}

/// Colours of all materials; of images their digests.
fn colours(manifest: &Manifest) -> Vec<([f32; 4], Option<Digest>)> {
    let image = |of: &TextureUse| Some(manifest.chunks(TEXTURES).get(of.texture as usize)?.digest);
    let of =
        |material: &Material| (material.base_colour, material.base_colour_texture.as_ref().and_then(image));
    manifest.materials.iter().map(of).collect()
}

fn receivers(clusters: &[ClusterTransport]) -> HashMap<Name, Receiver> {
    let mut all = HashMap::new();
    for cluster in clusters {
        let of = &cluster.receivers;
        for (row, name) in names(cluster).enumerate() {
            let lit = |of: &EmitterIrradiance| (of.emitter, of.irradiance[row]);
            let emitters = cluster.emitters.iter().map(lit).filter(|(_, light)| *light != [0.0; 3]).collect();
            let [position_m, normal] = [of.position_m[row], of.normal[row]].map(Vec3::from);
            all.insert(name, Receiver { position_m, normal, albedo: of.albedo[row], emitters });
        }
    }
    all
}

impl Comparison<'_> {
    /// The part of a cluster of before that is right for the edited scene, with colours and lamps as they are now; `None` if there is none.
    fn kept(&self, cluster: &ClusterTransport) -> Option<Kept> {
        if !cluster.near.blocks.iter().all(|block| self.blocks.contains(block)) {
            return None;
        }
        if self.by_columns && self.is_parted(cluster) {
            return None;
        }
        let reach_m = cluster.near.reach_m.max(NEAR_TEXELS * self.texel_m);
        let has_own = |hits: Range<usize>| {
            let hits = cluster.near.surface.get(hits).unwrap_or_default();
            self.has_other_colours && hits.iter().any(|hit| matches!(hit, NearSurface::Own { .. }))
        };
        let own = cluster.near.ranges().map(has_own).chain(std::iter::repeat(false));
        let places = cluster.receivers.position_m.iter().zip(&cluster.receivers.normal);
        let same: HashSet<Name> = names(cluster)
            .zip(places.zip(own))
            .filter(|(name, ((at, normal), own))| {
                !own && !self.walked.contains(&name.0)
                    && self.is_same(*name, (Vec3::from(**at), Vec3::from(**normal)), reach_m)
            })
            .map(|(name, _)| name)
            .collect();
        let mut kept = only(cluster, |name| same.contains(&name))?;
        let number = |key: &u64| self.before.light.transport.columns.number(PatchKey(*key).patch());
        let reads = |key: &&u64| !self.columns(PatchKey(**key)).is_empty();
        let read = kept.factors.keys.iter().filter(reads).filter_map(number).collect();
        rename_columns(&mut kept.factors, |key| {
            self.columns(PatchKey(key)).into_iter().map(|(key, sign)| (key.0, sign)).collect()
        });
        let now: Vec<&Receiver> = names(&kept).filter_map(|name| self.receivers.get(&name)).collect();
        kept.receivers.albedo = now.iter().map(|receiver| receiver.albedo).collect();
        let mut emitters: Vec<u16> =
            now.iter().flat_map(|receiver| receiver.emitters.iter().map(|(emitter, _)| *emitter)).collect();
        emitters.sort_unstable();
        emitters.dedup();
        let light = |emitter: u16, receiver: &Receiver| {
            let found = receiver.emitters.iter().find(|(other, _)| *other == emitter);
            found.map_or([0.0; 3], |(_, light)| *light)
        };
        let of = |emitter| EmitterIrradiance {
            emitter,
            irradiance: now.iter().map(|receiver| light(emitter, receiver)).collect(),
        };
        kept.emitters = emitters.into_iter().map(of).collect();
        Some(Kept { cluster: kept, read })
    }

    /// Ends of walks that are others now: those of before as the columns of a cluster read them.
    fn difference(&self, slot: u32, (before, now): (&[u32], &[u32]), read: &HashSet<u32>) -> Ends {
        let [first_before, first_now] = [self.before, self.after].map(Opened::first_of_sky);
        let is_sky = |place: u32| place >= first_before;
        let same = |place: u32| match is_sky(place) {
            true => Some(place - first_before + first_now),
            false => self
                .parts
                .get(place as usize)
                .filter(|(_, is_own)| *is_own)
                .and_then(|(parts, _)| most(parts)),
        };
        let mut left: BTreeMap<u32, usize> = BTreeMap::new();
        now.iter().for_each(|place| *left.entry(*place).or_default() += 1);
        let mut ends = Ends { slot, ..Ends::default() };
        for (index, &place) in before.iter().enumerate() {
            let along = (index as f32 + 0.5) / before.len() as f32;
            let found = same(place).and_then(|place| left.get_mut(&place)).filter(|count| **count > 0);
            match found {
                Some(count) => *count -= 1,
                None if is_sky(place) => ends.taken.extend(same(place)),
                None => ends.taken.extend(self.as_read((place, along), read)),
            }
        }
        for (place, count) in left {
            ends.added.extend(std::iter::repeat_n(place, count));
        }
        ends.taken.sort_unstable();
        ends
    }

    /// The finest patch with a column that a patch of before is part of, as it is now: of its parts the one at such a share of it.
    fn as_read(&self, (mut patch, along): (u32, f32), read: &HashSet<u32>) -> Option<u32> {
        let rows = &self.before.light.transport.columns.patches;
        while !read.contains(&patch) {
            patch = rows.get(patch as usize)?.parent;
        }
        let (parts, _) = self.parts.get(patch as usize)?;
        let mut left = along;
        let reaches = |(_, share): &&(u32, f32)| {
            left -= share;
            left < 0.0
        };
        parts.iter().find(reaches).or(parts.last()).map(|(part, _)| *part)
    }

    /// Columns that together are now the one that a key names, with their signs; none where it brings nothing any more.
    fn columns(&self, key: PatchKey) -> Vec<(PatchKey, f32)> {
        if let Some(part) = key.patch().sky() {
            return if part < self.after.patches.sky_parts { vec![(key, 1.0)] } else { Vec::new() };
        }
        let columns = &self.before.light.transport.columns;
        let parts_of = |patch: u32| self.parts.get(patch as usize).map(|(parts, _)| parts);
        let Some(patch) = columns.number(key.patch()) else { return Vec::new() };
        let whole = columns.patches.get(patch as usize).and_then(|row| parts_of(row.parent));
        let whole = whole.filter(|_| key.is_difference());
        let none = Parts::new();
        self.after.difference(parts_of(patch).unwrap_or(&none), whole.unwrap_or(&none))
    }

    /// Whether a receiver is there still, and nothing near it is another.
    fn is_same(&self, name: Name, (position_m, normal): (Vec3, Vec3), reach_m: f32) -> bool {
        self.receivers.get(&name).is_some_and(|now| {
            position_m.distance(now.position_m) <= MOVED_TEXELS * self.texel_m
                && normal.dot(now.normal) >= TURNED_COSINE
                && !self.changes.meet([position_m - reach_m, position_m + reach_m])
        })
    }

    /// Whether something has changed between a cluster and what it reads, or there.
    fn is_parted(&self, cluster: &ClusterTransport) -> bool {
        let bounds = cluster.bounds_m.map(Vec3::from);
        cluster
            .factors
            .keys
            .iter()
            .any(|key| self.changes.part(bounds, self.source_of(PatchKey(*key).patch())))
    }

    /// Where a column's light comes from.
    fn source_of(&self, key: PatchKey) -> Bounds {
        let Some(part) = key.sky() else {
            let side_m = self.texel_m * (1_u32 << key.level().min(14)) as f32;
            let low_m = IVec3::from(key.cell()).as_vec3() * side_m;
            return [low_m, low_m + side_m];
        };
        let far_m = self.after.scene.diagonal_m();
        let at_m = far_m * relight_direction(part, self.after.patches.sky_parts.max(part + 1));
        let [low, high] = self.after.scene.manifest.bounds_m.map(Vec3::from);
        [low + at_m - SKY_WIDTH * far_m, high + at_m + SKY_WIDTH * far_m]
    }
}

#[cfg(test)]
mod tests;
