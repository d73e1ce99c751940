//! `--dump FILE.csv`: every measured receiver, so that any outside renderer can be held against it.

use std::fmt::Write as _;
use std::path::Path;

use lightkiln_client::fetch::write_atomically;

use super::measure::Measured;
use crate::failure::Result;

/// First line of the file.
const HEADER: &str = "light,receiver,x_m,y_m,z_m,nx,ny,nz,area_m2,baked_r,baked_g,baked_b,full_rank_r,full_rank_g,\
                      full_rank_b,reference_r,reference_g,reference_b,error_r,error_g,error_b,direct_r,direct_g,\
                      direct_b,paths,counted\n";

/// Writes one line per light and receiver: place, normal, area, E_ind in W·m⁻² as baked, by full-rank transport and
/// by the reference with its standard error, and E_dir.
pub fn write_dump(path: &Path, measured: &Measured) -> Result<()> {
    let stage = &measured.evaluator.world().stage;
    let mut text = HEADER.to_owned();
    for result in &measured.results {
        for (index, sampled) in measured.evaluator.sample().receivers.iter().enumerate() {
            let receiver = &stage.receivers[sampled.receiver as usize];
            let (p, n) = (receiver.position_m, receiver.normal);
            let (baked, full_rank) = (result.baked[index], result.full_rank[index]);
            let reference = &result.reference[index];
            let (mean, error, direct) =
                (reference.indirect.mean, reference.indirect.error, reference.direct.mean);
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                field(&result.light.name),
                sampled.receiver,
                p.x,
                p.y,
                p.z,
                n.x,
                n.y,
                n.z,
                sampled.area_m2,
                baked.x,
                baked.y,
                baked.z,
                full_rank.x,
                full_rank.y,
                full_rank.z,
                mean.x,
                mean.y,
                mean.z,
                error.x,
                error.y,
                error.z,
                direct.x,
                direct.y,
                direct.z,
                reference.paths,
                u8::from(result.counted[index]),
            );
        }
    }
    Ok(write_atomically(path, text.as_bytes())?)
}

/// A text as a CSV field ([RFC 4180]): quoted where it must be.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_commas_and_quotes_stay_one_field() {
        assert_eq!(field("sun"), "sun");
        assert_eq!(field("a, \"b\""), "\"a, \"\"b\"\"\"");
    }
}
