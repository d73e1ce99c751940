//! Levels of detail.

use super::{Words, WordsError};
use crate::relight::{LOD_LEVELS, Lod, LodDistance, LodLevel, MAX_RANK};

const LOD: &str = "fine|balanced|coarse [level1=distance,columns,rank,receivers,interval (distance in scene diagonals, or metres as 20m)] \
                   [level2=…] [level3=…] [level0=…] [beside=f] [behind=f] [blend=share] [margin=share]";

/// Reads a preset's name, words that change it, or both; words alone begin with the most detail everywhere. Levels that are not
/// named and begin nowhere have the receivers of the one before.
pub fn lod_from_text(text: &str) -> Result<Lod, WordsError> {
    let mut rest = text.split_whitespace().peekable();
    let preset = rest.peek().and_then(|word| Lod::preset(word));
    let mut lod = preset.unwrap_or_else(full);
    if preset.is_some() {
        rest.next();
    }
    let mut words = Words::from_text(rest, LOD)?;
    let mut receivers = 0;
    for (index, level) in lod.levels.iter_mut().enumerate() {
        let key = format!("level{index}");
        if let Some((_, value)) = words.take(&[&key]) {
            *level = level_from(&value).ok_or_else(|| words.wrong(format!("'{key}={value}' is no level")))?;
        } else if level.distance == LodDistance::NOWHERE {
            level.receivers = receivers;
        }
        receivers = level.receivers;
    }
    let factors: [(&str, &mut f32); 4] = [
        ("beside", &mut lod.beside),
        ("behind", &mut lod.behind),
        ("blend", &mut lod.blend),
        ("margin", &mut lod.margin),
    ];
    for (key, factor) in factors {
        *factor = words.number(&[key], 0.0, 1e6)?.unwrap_or(*factor);
    }
    let wrong = lod.check().err().map(|error| words.wrong(error.to_string()));
    words.end()?;
    wrong.map_or(Ok(lod), Err)
}

/// Words that [`lod_from_text`] reads as those settings: the preset's name, if it is one.
pub fn lod_to_text(lod: &Lod) -> String {
    if let Some((name, _)) = Lod::PRESETS.iter().find(|(_, preset)| preset == lod) {
        return (*name).to_owned();
    }
    let level = |(index, level): (usize, &LodLevel)| {
        let LodLevel { distance, columns, rank, receivers, interval } = level;
        let distance = match distance {
            LodDistance::Diagonals(diagonals) => diagonals.to_string(),
            LodDistance::Metres(metres) => format!("{metres}m"),
        };
        format!("level{index}={distance},{columns},{rank},{receivers},{interval}")
    };
    let levels: Vec<String> = lod.levels.iter().enumerate().map(level).collect();
    let Lod { beside, behind, blend, margin, .. } = lod;
    format!("{} beside={beside} behind={behind} blend={blend} margin={margin}", levels.join(" "))
}

/// The most detail everywhere.
fn full() -> Lod {
    let mut levels = [LodLevel::full(LodDistance::NOWHERE); LOD_LEVELS];
    levels[0].distance = LodDistance::Diagonals(0.0);
    Lod { levels, ..Lod::PRESETS[1].1 }
}

fn level_from(text: &str) -> Option<LodLevel> {
    let [distance, columns, rank, receivers, interval] =
        <[&str; 5]>::try_from(text.split(',').collect::<Vec<_>>()).ok()?;
    let distance = match distance.strip_suffix('m') {
        Some(metres) => LodDistance::Metres(metres.parse().ok()?),
        None => LodDistance::Diagonals(distance.parse().ok()?),
    };
    let rank = if rank == "all" { MAX_RANK } else { rank.parse().ok()? };
    let [columns, receivers, interval] = [columns, receivers, interval].map(|number| number.parse().ok());
    Some(LodLevel { distance, columns: columns?, rank, receivers: receivers?, interval: interval? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_and_words_that_change_them_are_read_and_written_again() {
        for (name, preset) in Lod::PRESETS {
            assert_eq!(preset.check(), Ok(()), "{name}");
            assert_eq!(lod_from_text(name), Ok(preset));
            assert_eq!(lod_to_text(&preset), name);
        }
        let changed = lod_from_text("coarse level2=20m,4,all,1,2 level3=40m,5,8,3,4 behind=8").unwrap();
        assert_eq!(changed.levels[2].distance, LodDistance::Metres(20.0));
        assert_eq!((changed.levels[2].rank, changed.behind, changed.beside), (256, 8.0, 2.0));
        assert_eq!(lod_from_text(&lod_to_text(&changed)), Ok(changed));
        for text in ["level1=0.5,3,16,1,2", "level2=20m,3,16,3,2", "level0=0,3,16,2,1"] {
            let words = lod_from_text(text).unwrap();
            assert_eq!(lod_from_text(&lod_to_text(&words)), Ok(words), "{text}");
        }
        let words = lod_from_text("level1=0.5,3,16,1,2 level3=inf,3,16,2,2").unwrap();
        assert_eq!(words.levels.map(|level| level.receivers), [0, 1, 1, 2]);
    }

    #[test]
    fn levels_that_would_begin_before_the_one_before_are_told_of() {
        let notes = |text: &str, diagonal_m| lod_from_text(text).unwrap().notes(diagonal_m);
        let small = notes("balanced level1=20m,3,16,1,2", 10.0);
        assert_eq!(small.len(), 2, "{small:?}");
        assert!(small[0].contains("level 2") && small[0].contains("2.5 m") && small[0].contains("20.0 m"));
        assert!(small[1].contains("level 3"), "{small:?}");
        assert_eq!(notes("balanced level1=20m,3,16,1,2", 100.0), [""; 0]);
        for diagonal_m in [0.01, 1.0, 1e4] {
            for text in ["balanced level1=0.2,3,16,1,2", "fine", "balanced", "coarse", "level1=20m,3,16,1,2"]
            {
                assert_eq!(notes(text, diagonal_m), [""; 0], "{text} in {diagonal_m} m");
            }
        }
    }

    #[test]
    fn settings_out_of_range_are_errors_that_name_the_word() {
        for (text, word) in [
            ("rough", "'rough'"),
            ("level1=0.5,3,16,1", "level1"),
            ("level1=-1,3,16,1,1", "level 1"),
            ("level1=nan,3,16,1,1", "level 1"),
            ("level1=0.5,3,16,1,3", "interval 3"),
            ("level1=0.5,3,16,4,1", "receivers of level 4"),
            ("level1=0.5,3,0,1,1", "rank 0"),
            ("level1=0.5,16,8,1,1", "columns"),
            ("coarse level1=0.1,3,8,3,2", "more receivers"),
            ("coarse beside=0.5", "beside"),
            ("coarse beside=4 behind=2", "behind"),
            ("coarse blend=2", "blend"),
            ("coarse blend=1 blend=1", "twice"),
            ("coarse level4=0,1,2,3,4", "level4"),
        ] {
            let error = lod_from_text(text).unwrap_err().to_string();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
