//! From the rows of a cell to factorised clusters.

use glam::Vec3;
use lightkiln_proto::content::{BlockKey, Texel, TransportFactors};
use lightkiln_proto::kinds::prt::PatchSettings;

use super::near::{self, NearHit};
use super::{Row, TracedSettings};
use crate::factors::{ClusterCell, Factored, Part, PatchMatrix, Piece, Truncation, split};
use crate::lightmap::{Numbering, World};
use crate::task::{Cancelled, Progress};

/// A cell while it is factorised.
struct Cell<'a> {
    world: &'a World,
    settings: &'a TracedSettings,
    /// Patches, then parts of the sky.
    keys: &'a [u64],
    receivers: Numbering<u32>,
    /// One per receiver.
    rows: &'a [Row],
    matrix: PatchMatrix<'a>,
}

/// A cluster, and the receivers that near hits with surfaces of their own have the albedo of, in the order of the hits.
pub type NamedPiece = (Piece, Vec<(BlockKey, Texel)>);

/// Factorised clusters of a cell, in a fixed order.
pub fn pieces(
    (world, settings): (&World, &TracedSettings),
    keys: &[u64],
    cell: &ClusterCell,
    rows: &[Row],
    progress: &Progress,
) -> Result<Vec<NamedPiece>, Cancelled> {
    let own = Cell {
        world,
        settings,
        keys,
        receivers: Numbering::of(cell.receivers.iter().copied()),
        rows,
        matrix: PatchMatrix::new(keys, rows.iter().map(|row| (&row.shared.alpha[..], &row.importance))),
    };
    // Leave dead receivers out: their texels are filled from their neighbours, which keeps edges from turning dark.
    let live = cell.receivers.iter().zip(rows).filter(|(_, row)| !row.is_dead());
    let receivers: Vec<u32> = live.map(|(&receiver, _)| receiver).collect();
    // Factorise receivers apart that nothing joins, so that no error of a lit room shines into a dark one.
    let (links, linking) = own.links(&receivers);
    let parts = split(&own, &ClusterCell { bounds_m: cell.bounds_m, receivers }, &links, linking, progress)?;
    Ok(parts.into_iter().map(|part| own.piece(part)).collect())
}

impl Truncation for Cell<'_> {
    fn factored(&self, receivers: &[u32]) -> (Factored, bool) {
        let places = self.places(receivers);
        let (factors, suffices) = self.matrix.factored(&places, self.settings.truncation());
        let groups = self.matrix.used(&places);
        // One cut has no more; rows of several, as those of probes, may have.
        let PatchSettings { patches_max, sky_parts, .. } = self.settings.patches;
        let fits = groups.len() <= (patches_max + sky_parts.max(1)) as usize;
        (Factored { factors, groups }, suffices && fits)
    }

    fn has_columns(&self, receiver: u32) -> bool {
        !self.settings.is_bare && !self.matrix.used(&[self.receivers.place(receiver)]).is_empty()
    }

    fn position_m(&self, receiver: u32) -> Vec3 {
        self.world.lightmap.receivers[receiver as usize].position_m
    }

    fn may_split(&self, receivers: usize, size_m: f32) -> bool {
        receivers > self.settings.factors.split_receivers_min as usize && size_m > self.world.lightmap.texel_m
    }

    fn rank_max(&self) -> usize {
        self.settings.factors.rank_max as usize
    }
}

impl Cell<'_> {
    /// Indices of receivers' rows.
    fn places(&self, receivers: &[u32]) -> Vec<usize> {
        receivers.iter().map(|&receiver| self.receivers.place(receiver)).collect()
    }

    /// Nodes that join rows: columns but the sky's, as the sky is above rooms that have nothing else in common, and texels
    /// that are hit close by, which have no columns; and the number of both.
    fn links(&self, live: &[u32]) -> (Vec<Vec<u32>>, usize) {
        let near_texels = |row: &Row| row.near.iter().filter_map(NearHit::texel).collect::<Vec<_>>();
        let texels = Numbering::of(self.rows.iter().flat_map(near_texels));
        let of_receiver = |&receiver: &u32| {
            let place = self.receivers.place(receiver);
            let mut links = self.matrix.met_patches(place);
            // The receiver's own texel is one of them where another row hits it.
            let hit = near_texels(&self.rows[place]).into_iter().chain([receiver]);
            links.extend(hit.filter_map(|texel| Some((self.keys.len() + texels.find(texel)?) as u32)));
            links
        };
        (live.iter().map(of_receiver).collect(), self.keys.len() + texels.len())
    }

    fn piece(&self, Part { receivers, factored: Factored { factors, groups } }: Part) -> NamedPiece {
        let places = self.places(&receivers);
        let rows: Vec<&Row> = places.iter().map(|&place| &self.rows[place]).collect();
        let keys = groups.iter().map(|&column| self.keys[column as usize]).collect();
        let columns = TransportFactors { keys, ..TransportFactors::default() };
        let near = near::of_rows(self.world, self.settings, &receivers, &rows);
        let shared: Vec<_> = rows.iter().map(|row| &row.shared).collect();
        let near_own = near::own_of_rows(&self.world.lightmap, &rows);
        (Piece::of(&self.world.lightmap, &receivers, &shared, columns, factors, near), near_own)
    }
}
