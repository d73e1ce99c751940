//! Irradiance of each part of the sky at receivers, without factors: for light that differs from one receiver to the next.

use glam::Vec4;

use super::{Columns, Parallel, Sky, Transport};

/// Irradiance at receivers by radiance 1 of each part of the sky, in sr.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkyRows {
    parts: usize,
    /// Part after part of one slot, then of the next.
    rows: Vec<f32>,
}

impl SkyRows {
    /// Parts of the sky.
    pub fn parts(&self) -> usize {
        self.parts
    }

    /// Receivers.
    pub fn receivers(&self) -> usize {
        self.rows.len() / self.parts.max(1)
    }

    /// By part, of a slot.
    pub fn row(&self, slot: usize) -> &[f32] {
        &self.rows[slot * self.parts..][..self.parts]
    }
}

impl<C: Columns> Transport<C> {
    /// Of all parts of the sky, before any bounce.
    pub fn sky_rows(&self, parallel: &impl Parallel) -> SkyRows {
        let Self { receivers, clusters, walked, columns, .. } = self;
        let parts = columns.sky_lambda(Sky::default()).len();
        let mut rows = vec![0.0; receivers.len() * parts];
        // Three parts at a time, each as one colour.
        for first in (0..parts).step_by(3) {
            let own = (first..parts).take(3);
            let mut lambda = vec![Vec4::ZERO; columns.lambda_count()];
            let sky = lambda.len() - parts;
            own.clone().for_each(|part| lambda[sky + part][part - first] = 1.0);
            let mut start = vec![Vec4::ZERO; receivers.len()];
            walked.gather(parallel, &lambda, &mut start);
            let found = clusters.reconstruct(parallel, &clusters.basis(parallel, &lambda), &start, None);
            for (row, light) in rows.chunks_exact_mut(parts).zip(&found) {
                own.clone().for_each(|part| row[part] = light[part - first]);
            }
        }
        SkyRows { parts, rows }
    }
}
