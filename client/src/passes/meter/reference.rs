//! The grid on the processor.

use glam::Vec4;

use super::MeterNumbers;

/// Radiance at the grid's points, row after row.
pub fn gather(numbers: MeterNumbers, radiance: &[Vec4]) -> Vec<Vec4> {
    let MeterNumbers { columns, rows, width, height } = numbers;
    let at = |index: u32, count: u32, pixels: u32| (2 * index + 1) * pixels / (2 * count);
    let points = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let pixel = |(column, row)| at(row, rows, height) * width + at(column, columns, width);
    points.map(|point| radiance[pixel(point) as usize]).collect()
}
