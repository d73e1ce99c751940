//! From the rows of a cell to factorised clusters, by the columns that light is expected to need.

use lightkiln_proto::content::{ClusterTransport, PatchKey};

use glam::Vec3;

use super::near::{self, NearHit};
use super::{PatchTransport, Row, TracedSettings};
use crate::factors::{
    ClusterCell, Factors, Matrix, Piece, Truncation, attributes, bounds_m, emitters, factorise, split,
};
use crate::lightmap::{Lightmap, Numbering};
use crate::rays::sampling::seed_of;
use crate::transport;

/// Least square of a singular value that counts, over that of its noise: those of noise alone are above the mean, as the
/// decomposition looks for the largest.
const NOISE_FACTOR: f64 = 2.0;
/// Least share of a matrix that is taken for signal, in squares: of single rays nobody knows.
const SIGNAL_MIN: f64 = 1e-6;

/// A cell while it is factorised.
struct Cell<'a> {
    lightmap: &'a Lightmap,
    settings: &'a TracedSettings,
    /// Patches, then parts of the sky.
    keys: &'a [u64],
    receivers: Numbering<u32>,
    /// One per receiver.
    rows: &'a [Row],
    /// Importance-weighted rows, and the noise in them.
    importance: [Vec<Vec<f32>>; 2],
}

/// Factorised clusters of a cell, in a fixed order.
pub fn pieces(transport: &PatchTransport, keys: &[u64], cell: &ClusterCell, rows: &[Row]) -> Vec<Piece> {
    let own = Cell {
        lightmap: &transport.world.lightmap,
        settings: &transport.settings,
        keys,
        receivers: Numbering::of(cell.receivers.iter().copied()),
        rows,
        importance: importance(keys, rows),
    };
    // Leave dead receivers out: their texels are filled from their neighbours, which keeps edges from turning dark.
    let live = cell.receivers.iter().zip(rows).filter(|(_, row)| !row.is_dead());
    let receivers: Vec<u32> = live.map(|(&receiver, _)| receiver).collect();
    // Factorise receivers apart that nothing joins, so that no error of a lit room shines into a dark one.
    let (links, linking) = own.links(&receivers);
    let groups = split(&own, &ClusterCell { bounds_m: cell.bounds_m, receivers }, &links, linking);
    groups.into_iter().map(|(receivers, factors)| own.piece(&receivers, factors)).collect()
}

/// Index of the first key that stands for a part of the sky.
fn first_sky(keys: &[u64]) -> usize {
    keys.partition_point(|&key| PatchKey(key).sky().is_none())
}

/// Importance-weighted rows and their noise. The sky's columns count for no more than the others: where most of the
/// hemisphere is sky, the rest is the whole light when it is dark.
fn importance(keys: &[u64], rows: &[Row]) -> [Vec<Vec<f32>>; 2] {
    let first_sky = first_sky(keys) + 1;
    let mut importance =
        [0, 1].map(|which: usize| rows.iter().map(|row| row.importance[which].clone()).collect());
    let of_patches: f64 = rows.iter().map(|row| squares(&row.importance[0][..first_sky])).sum();
    let of_sky: f64 = rows.iter().map(|row| squares(&row.importance[0][first_sky..])).sum();
    if of_patches > 0.0 && of_sky > of_patches {
        let scale = (of_patches / of_sky).sqrt() as f32;
        let all = importance.iter_mut().flat_map(|rows: &mut Vec<Vec<f32>>| rows);
        all.flat_map(|row| &mut row[first_sky..]).for_each(|value| *value *= scale);
    }
    importance
}

fn squares(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value).powi(2)).sum()
}

impl Truncation for Cell<'_> {
    type Factored = Factors;

    /// U of the importance-weighted matrix with a column for the sum, and ΣVᵀ = UᵀA, so that a cluster's energy is right
    /// under every light. The rank is the smallest whose dropped signal is within the error that is set.
    fn factored(&self, receivers: &[u32]) -> (Factors, bool) {
        let (settings, rows) = (&self.settings.factors, self.places(receivers));
        // Factorise to the highest rank: which of it is signal is seen only afterwards.
        let [weighted, noise] = [0, 1].map(|which| self.weighted(&rows, which));
        let rank_max = settings.rank_max as usize;
        let mut factors = factorise(&weighted, rank_max, 0.0, &self.seeds());
        if factors.rank == 0 {
            return (factors, true);
        }
        // Drop ranks from the last on while their signal fits into the error: noise, which the two halves of the rays do
        // not share, is worth no rank.
        let (rank, error) = self.rank(&factors, &weighted, &noise);
        // One more column for the sum over receivers keeps energy exact.
        (factors.rank, factors.u) = factors.with_sum(rank, rows.len());
        // Project A itself on U: then only columns are lost that no receiver tells apart.
        factors.vt = factors.projected(&self.alpha(&rows));
        factors.truncation_error = error;
        let suffices = error <= settings.rank_error;
        (factors, suffices)
    }

    fn position_m(&self, receiver: u32) -> Vec3 {
        self.lightmap.receivers[receiver as usize].position_m
    }

    fn may_split(&self, receivers: usize, size_m: f32) -> bool {
        receivers > self.settings.factors.split_receivers_min as usize && size_m > self.lightmap.texel_m
    }
}

impl Cell<'_> {
    /// Indices of receivers' rows.
    fn places(&self, receivers: &[u32]) -> Vec<usize> {
        receivers.iter().map(|&receiver| self.receivers.place(receiver)).collect()
    }

    /// Importance-weighted rows, or the noise in them.
    fn weighted(&self, rows: &[usize], which: usize) -> Matrix {
        let values = rows.iter().flat_map(|&row| &self.importance[which][row]).copied().collect();
        Matrix { rows: rows.len(), columns: self.keys.len() + 2, values }
    }

    /// Rows of A; the sky's group is none of them, as the sky's parts have keys.
    fn alpha(&self, rows: &[usize]) -> Matrix {
        let columns = self.used(rows);
        let of_row =
            |&row: &usize| columns.iter().map(move |&column| self.rows[row].shared.alpha[column as usize]);
        let values = rows.iter().flat_map(of_row).collect();
        Matrix { rows: rows.len(), columns: columns.len(), values }
    }

    /// Columns with anything in them, as indices of keys.
    fn used(&self, rows: &[usize]) -> Vec<u32> {
        let is_used =
            |&column: &u32| rows.iter().any(|&row| self.rows[row].shared.alpha[column as usize] != 0.0);
        (0..self.keys.len() as u32).filter(is_used).collect()
    }

    /// The smallest rank whose dropped signal is within the error that is set, and that error.
    fn rank(&self, factors: &Factors, weighted: &Matrix, noise: &Matrix) -> (usize, f32) {
        let settings = &self.settings.factors;
        let values = squares(&weighted.values);
        let total = (values - squares(&noise.values)).max(SIGNAL_MIN * values);
        let columns = weighted.columns.max(1);
        let noise_of = factors.projected(noise);
        let of_ranks: Vec<[f64; 2]> = factors
            .vt
            .chunks_exact(columns)
            .zip(noise_of.chunks_exact(columns))
            .map(|(values, noise)| [squares(values), squares(noise)])
            .collect();
        let known: f64 = of_ranks.iter().map(|[values, noise]| values - noise).sum();
        let mut left_out = (total - known).max(0.0);
        let allowed = f64::from(settings.rank_error).powi(2) * total;
        let mut rank = factors.rank;
        while rank > 0 {
            let [values, noise] = of_ranks[rank - 1];
            let signal = (values - NOISE_FACTOR * noise).max(0.0);
            if left_out + signal > allowed && rank < settings.rank_max as usize {
                break;
            }
            (left_out, rank) = (left_out + signal, rank - 1);
        }
        (rank, (left_out / total).sqrt() as f32)
    }

    /// Nodes that join rows: columns but the sky's, as the sky is above rooms that have nothing else in common, and texels
    /// that are hit close by, which have no columns; and the number of both.
    fn links(&self, live: &[u32]) -> (Vec<Vec<u32>>, usize) {
        let near_texels = |row: &Row| row.near.iter().filter_map(NearHit::texel).collect::<Vec<_>>();
        let texels = Numbering::of(self.rows.iter().flat_map(near_texels));
        let first_sky = first_sky(self.keys) as u32;
        let of_receiver = |&receiver: &u32| {
            let place = self.receivers.place(receiver);
            let mut links = self.used(&[place]);
            links.retain(|&column| column < first_sky);
            // The receiver's own texel is one of them where another row hits it.
            let hit = near_texels(&self.rows[place]).into_iter().chain([receiver]);
            links.extend(hit.filter_map(|texel| Some((self.keys.len() + texels.find(texel)?) as u32)));
            links
        };
        (live.iter().map(of_receiver).collect(), self.keys.len() + texels.len())
    }

    /// One seed per importance-weighted column, from the identity of its patch or part of the sky.
    fn seeds(&self) -> Vec<u64> {
        let common = |which: u64| seed_of(&[which, 6]);
        let mut seeds: Vec<u64> = self.keys.iter().map(|&key| seed_of(&[key, 5])).collect();
        seeds.insert(first_sky(self.keys), common(0));
        seeds.push(common(1));
        seeds
    }

    fn piece(&self, receivers: &[u32], factors: Factors) -> Piece {
        let places = self.places(receivers);
        let rows: Vec<&Row> = places.iter().map(|&place| &self.rows[place]).collect();
        let shared: Vec<&transport::Row> = rows.iter().map(|row| &row.shared).collect();
        let lit: f32 = shared.iter().map(|row| row.lit).sum();
        let uncovered: f32 = shared.iter().map(|row| row.uncovered).sum();
        let transport = ClusterTransport {
            bounds_m: bounds_m(self.lightmap, receivers),
            receivers: attributes(self.lightmap, receivers),
            keys: self.used(&places).iter().map(|&column| self.keys[column as usize]).collect(),
            bands: 0,
            sky: false,
            rank: factors.rank as u32,
            u: factors.u,
            vt: factors.vt,
            emitters: emitters(&shared),
            near: near::of_rows(self.lightmap, self.settings, receivers, &rows),
        };
        Piece {
            transport,
            truncation_error: factors.truncation_error,
            s1_criterion_bound: factors.s1_criterion_bound,
            uncovered_fraction: if lit > 0.0 { uncovered / lit } else { 0.0 },
        }
    }
}
