//! Clusters and their factors: λ → b → irradiance at receivers, or whatever else their rows stand for.

use glam::Vec4;

use super::lod::Detail;
use super::packed::{GROUP, Packing, column_order, number_of, pack_u, pack_vt, step_of};
use super::{ALWAYS, Columns, Inconsistent, Parallel};
use crate::content::{EmitterIrradiance, TransportFactors};

/// Highest rank of a cluster that is read.
pub const MAX_RANK: u32 = 256;

/// A cluster's share of the flat arrays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cluster {
    /// First row: the slot of its first receiver where rows are receivers.
    pub first_row: usize,
    /// Rows.
    pub row_count: usize,
    /// First entry in [`ClusterTable::columns`].
    pub first_column: usize,
    /// Columns n of ΣVᵀ.
    pub column_count: usize,
    /// Rank k.
    pub rank: usize,
    /// First of its entries in the array b: k, then zeros up to a whole group.
    pub first_b: usize,
    /// Its numbers in [`ClusterTable::u`].
    pub u: Packing,
    /// Its numbers in [`ClusterTable::vt`].
    pub vt: Packing,
}

impl Cluster {
    /// Its rows.
    pub fn rows(&self) -> std::ops::Range<usize> {
        self.first_row..self.first_row + self.row_count
    }
}

/// A column of ΣVᵀ as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Column {
    /// Place in λ of the number that it reads.
    pub place: u32,
    /// Scale of its numbers.
    pub scale: f32,
}

/// Clusters and their factors.
#[derive(Debug, Default)]
pub struct ClusterTable {
    /// Clusters in the manifest's order.
    pub clusters: Vec<Cluster>,
    /// U of all clusters, packed.
    pub u: Vec<u32>,
    /// ΣVᵀ of all clusters, packed.
    pub vt: Vec<u32>,
    /// Columns, cluster after cluster.
    pub columns: Vec<Column>,
    /// Level of each column, see [`Columns::level`]; it falls within each class of columns.
    pub column_levels: Vec<u8>,
    /// By entry of b: the step of U times that of ΣVᵀ.
    pub steps: Vec<f32>,
    /// Length of the array b.
    pub b_len: usize,
}

impl ClusterTable {
    /// Joins clusters, each given by its factors and the number of its rows, whose columns read `columns`.
    pub fn join<'a>(
        clusters: impl IntoIterator<Item = (&'a TransportFactors, usize)>,
        columns: &impl Columns,
    ) -> Result<Self, Inconsistent> {
        let (mut table, mut first_row) = (Self::default(), 0);
        for (index, (factors, rows)) in clusters.into_iter().enumerate() {
            check(factors, rows, columns)
                .and_then(|()| table.push(factors, columns, first_row, rows))
                .map_err(|problem| Inconsistent::new(format!("cluster {index}"), problem))?;
            first_row += rows;
        }
        Ok(table)
    }

    fn push(
        &mut self,
        factors: &TransportFactors,
        columns: &impl Columns,
        first_row: usize,
        row_count: usize,
    ) -> Result<(), String> {
        let first_column = self.columns.len();
        let (of_key, all) = (factors.coefficients(), columns.coefficients());
        let mut levels = Vec::new();
        let mut push = |carrier: u32, scale: f32, level: u8| -> Result<(), String> {
            // A cluster of fewer bands, as a prefix of its chunk has, reads the first of each.
            for place in (0..of_key).map(|j| carrier as usize * all + j) {
                let place = u32::try_from(place).map_err(|_| format!("column {place} of λ is too many"))?;
                self.columns.push(Column { place, scale });
                levels.push(level);
            }
            Ok(())
        };
        for (index, &key) in factors.keys.iter().enumerate() {
            let found = columns.index(key).ok_or_else(|| format!("column {key:016x} is in no chunk"))?;
            push(found, factors.steps.scale.get(index).copied().unwrap_or(1.0), columns.level(key))?;
        }
        if factors.sky {
            push(columns.sky_index().ok_or("has columns of a sky that the bake lacks")?, 1.0, ALWAYS)?;
        }
        let own = self.columns.split_off(first_column);
        let (rank, column_count) = (factors.rank as usize, own.len());
        let step_of_u = |i: usize| step_of(&factors.steps.u, i);
        let step_of_vt = |i: usize| step_of(&factors.steps.vt, i);
        let u = pack_u(&mut self.u, [rank, row_count], |row, i| {
            number_of(factors.u[row * rank + i], step_of_u(i), 1.0)
        });
        let numbers: Vec<f32> = (0..rank * column_count)
            .map(|index| {
                let (i, column) = (index / column_count, index % column_count);
                number_of(factors.vt[index], step_of_vt(i), own[column].scale)
            })
            .collect();
        let number = |i: usize, column: usize| numbers[i * column_count + column];
        let order = column_order([column_count, rank], &levels, number);
        self.columns.extend(order.iter().map(|&column| own[column]));
        self.column_levels.extend(order.iter().map(|&column| levels[column]));
        let vt = pack_vt(&mut self.vt, [column_count, rank], |i, column| number(i, order[column]));
        let first_b = self.b_len;
        self.b_len += rank.next_multiple_of(GROUP);
        self.steps.extend((0..rank).map(|i| step_of_u(i) * step_of_vt(i)));
        if !self.steps[first_b..].iter().all(|step| step.is_finite()) {
            return Err("its steps are too large".to_owned());
        }
        self.steps.resize(self.b_len, 0.0);
        self.clusters.push(Cluster {
            first_row,
            row_count,
            first_column,
            column_count,
            rank,
            first_b,
            u,
            vt,
        });
        Ok(())
    }

    /// `b_c = s (ΣVᵀ) λ|_c`, all clusters' numbers one after the other. They carry the step s of U already: [`Self::reconstruct`] multiplies
    /// them by U's whole numbers.
    pub fn basis(&self, parallel: &impl Parallel, lambda: &[Vec4]) -> Vec<Vec4> {
        let of_cluster = |index: usize| {
            let cluster = &self.clusters[index];
            self.basis_of(cluster, &Detail::full(cluster), lambda)
        };
        parallel.map(self.clusters.len(), of_cluster).concat()
    }

    /// b of one cluster in some detail: whole groups of ranks.
    pub(super) fn basis_of(&self, cluster: &Cluster, detail: &Detail, lambda: &[Vec4]) -> Vec<Vec4> {
        let mut b = vec![Vec4::ZERO; GROUP * detail.groups as usize];
        let counts = [detail.wide, detail.bytes, detail.rest];
        for index in
            cluster.classes().into_iter().zip(counts).flat_map(|(class, count)| class.take(count as usize))
        {
            let column = &self.columns[cluster.first_column + index];
            let light = lambda[column.place as usize] * column.scale;
            for (group, b) in b.chunks_exact_mut(GROUP).enumerate() {
                let numbers = cluster.vt_numbers(&self.vt, group, index);
                b.iter_mut().zip(numbers).for_each(|(b, number)| *b += number * light);
            }
        }
        b.iter_mut().zip(&self.steps[cluster.first_b..]).for_each(|(b, step)| *b *= *step);
        b
    }

    /// `N + U_r · b_c` of a row, which counts from the cluster's first, in as many groups of ranks as `b` has.
    pub(super) fn row_of(&self, cluster: &Cluster, row: usize, b: &[Vec4], start: Vec4) -> Vec4 {
        let of_group = |sum: Vec4, (group, b): (usize, &[Vec4])| {
            let numbers = cluster.u_numbers(&self.u, group, row);
            b.iter().zip(numbers).fold(sum, |sum, (b, number)| sum + number * *b)
        };
        b.chunks_exact(GROUP).enumerate().fold(start, of_group)
    }

    /// `E_r = max(N_r + U_r · b_c, −F_r)` in W·m⁻², by row; without F, as for rows that have a sign, the sum itself.
    ///
    /// N is `start`. F is `beside`, light that is added to E: of receivers E_emit. Truncation and ringing can make a sum
    /// slightly negative. The whole, E + F, is clamped at 0, not its parts, so that no light is gained.
    pub fn reconstruct(
        &self,
        parallel: &impl Parallel,
        b: &[Vec4],
        start: &[Vec4],
        beside: Option<&[Vec4]>,
    ) -> Vec<Vec4> {
        let of_cluster = |index: usize| -> Vec<Vec4> {
            let cluster = &self.clusters[index];
            let b = &b[cluster.first_b..][..GROUP * cluster.groups()];
            let at = |row: usize| {
                let sum = self.row_of(cluster, row - cluster.first_row, b, start[row]);
                beside.map_or(sum, |beside| sum.max(-beside[row]))
            };
            cluster.rows().map(at).collect()
        };
        parallel.map(self.clusters.len(), of_cluster).concat()
    }
}

fn check(factors: &TransportFactors, rows: usize, columns: &impl Columns) -> Result<(), String> {
    if factors.bands > columns.bands() {
        return Err(format!("has {} bands, the bake {}", factors.bands, columns.bands()));
    }
    if factors.rank > MAX_RANK {
        return Err(format!("has rank {}, at most {MAX_RANK}", factors.rank));
    }
    let rank = factors.rank as usize;
    if factors.u.len() != rows * rank || factors.vt.len() != factors.columns() * rank {
        return Err("its factors do not have the lengths that rank, rows and columns ask for".to_owned());
    }
    if !factors.u.iter().chain(&factors.vt).all(|value| value.is_finite()) {
        return Err("a factor is not a finite number".to_owned());
    }
    Ok(())
}

/// Irradiance straight from one emitter at one cluster's rows.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterPart {
    /// Emitter.
    pub emitter: u16,
    /// First row.
    pub first_row: usize,
    /// W·m⁻² at scale 1, one per row.
    pub irradiance: Vec<[f32; 3]>,
}

/// Irradiance straight from emissive surfaces at all rows.
#[derive(Debug, Default)]
pub struct EmitterTable(pub Vec<EmitterPart>);

impl EmitterTable {
    /// Joins the parts of clusters, each with the number of its rows, of a bake of so many emitters.
    pub fn join<'a>(
        clusters: impl IntoIterator<Item = (&'a [EmitterIrradiance], usize)>,
        emitters: usize,
    ) -> Result<Self, Inconsistent> {
        let (mut table, mut first_row) = (Self::default(), 0);
        for (index, (parts, rows)) in clusters.into_iter().enumerate() {
            for EmitterIrradiance { emitter, irradiance } in parts {
                if irradiance.len() != rows || usize::from(*emitter) >= emitters {
                    let problem =
                        format!("its light from emitter {emitter} has a wrong length or no emitter");
                    return Err(Inconsistent::new(format!("cluster {index}"), problem));
                }
                table.0.push(EmitterPart { emitter: *emitter, first_row, irradiance: irradiance.clone() });
            }
            first_row += rows;
        }
        Ok(table)
    }

    /// Irradiance at `rows` rows, W·m⁻²; `scale` is one factor per emitter, 1 if absent.
    pub fn irradiance(&self, rows: usize, scale: &[f32]) -> Vec<Vec4> {
        let mut sum = vec![Vec4::ZERO; rows];
        for part in &self.0 {
            let factor = scale.get(usize::from(part.emitter)).copied().unwrap_or(1.0);
            for (row, irradiance) in sum[part.first_row..].iter_mut().zip(&part.irradiance) {
                *row += super::four(*irradiance) * factor;
            }
        }
        sum
    }
}
