//! Stances: where an object that moves is.

use super::{Words, WordsError};
use crate::scene::Stance;

const STANCE: &str = "[pos=x,y,z] [turn=yaw,pitch,roll (degrees)] [scale=s] [time=seconds] [clip=n] [swing=yaw,pitch,roll] [hinge=x,y,z]";
/// Keys of the words.
const KEYS: [&str; 7] = ["pos", "turn", "scale", "time", "clip", "swing", "hinge"];
/// Farthest place along an axis in metres.
const PLACE_MAX_M: f32 = 1e6;
/// Smallest and largest scale.
const SCALES: [f32; 2] = [1e-4, 1e4];
/// Longest time into an animation in seconds.
const TIME_MAX: f32 = 1e6;
/// Most animations of a file.
const CLIPS_MAX: f32 = 65_536.0;

/// Reads `pos=x,y,z turn=yaw,pitch,roll scale=s time=seconds clip=n swing=yaw,pitch,roll hinge=x,y,z`, each left out where it changes nothing:
/// lengths in metres, turns in degrees about the object's y, then x, then z axis, animations counted from 1. `swing` turns the object about
/// `hinge`, a point of its own space, before all else.
pub fn stance_from_text(text: &str) -> Result<Stance, WordsError> {
    let mut words = Words::from_text(text.split_whitespace(), STANCE)?;
    let rest = Stance::default();
    let position_m = words.vector(&["pos"])?.map_or(rest.position_m, Into::into);
    if position_m.iter().any(|axis: &f32| axis.abs() > PLACE_MAX_M) {
        return Err(words.wrong(format!("'pos' is farther than {PLACE_MAX_M} m")));
    }
    let turn_deg = words.vector(&["turn"])?.map_or(rest.turn_deg, Into::into);
    let scale = words.number(&["scale"], SCALES[0], SCALES[1])?.unwrap_or(rest.scale);
    let time_s = words.number(&["time"], 0.0, TIME_MAX)?.unwrap_or(rest.time_s);
    let clip = words.number(&["clip"], 1.0, CLIPS_MAX)?;
    if clip.is_some_and(|clip| clip.fract() != 0.0) {
        return Err(words.wrong("'clip' is not a whole number"));
    }
    let clip = clip.map_or(rest.clip, |clip| clip as u32 - 1);
    let swing_deg = words.vector(&["swing"])?.map_or(rest.swing_deg, Into::into);
    let hinge_m = words.vector(&["hinge"])?.map_or(rest.hinge_m, Into::into);
    if hinge_m.iter().any(|axis: &f32| axis.abs() > PLACE_MAX_M) {
        return Err(words.wrong(format!("'hinge' is farther than {PLACE_MAX_M} m")));
    }
    words.end()?;
    Ok(Stance { position_m, turn_deg, scale, time_s, clip, swing_deg, hinge_m })
}

/// Words that [`stance_from_text`] reads as that stance, without those that change nothing.
pub fn stance_to_text(stance: &Stance) -> String {
    let rest = Stance::default();
    let three = |[x, y, z]: [f32; 3]| format!("{x},{y},{z}");
    let words = [
        (stance.position_m != rest.position_m).then(|| format!("pos={}", three(stance.position_m))),
        (stance.turn_deg != rest.turn_deg).then(|| format!("turn={}", three(stance.turn_deg))),
        (stance.scale != rest.scale).then(|| format!("scale={}", stance.scale)),
        (stance.time_s != rest.time_s).then(|| format!("time={}", stance.time_s)),
        (stance.clip != rest.clip).then(|| format!("clip={}", stance.clip + 1)),
        (stance.swing_deg != rest.swing_deg).then(|| format!("swing={}", three(stance.swing_deg))),
        (stance.hinge_m != rest.hinge_m).then(|| format!("hinge={}", three(stance.hinge_m))),
    ];
    words.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

/// A file and its stance: `FILE pos=… turn=…`. The file's name may have spaces.
pub fn object_from_text(text: &str) -> Result<(String, Stance), WordsError> {
    let is_word = |word: &str| word.split_once('=').is_some_and(|(key, _)| KEYS.contains(&key));
    let mut file = text.trim_end();
    let mut words = Vec::new();
    while let Some((before, word)) = file.rsplit_once(char::is_whitespace).filter(|(_, word)| is_word(word)) {
        words.push(word);
        file = before.trim_end();
    }
    words.reverse();
    let file = file.trim_start();
    if file.is_empty() || is_word(file) {
        let problem = format!("'{text:.200}' begins with no file");
        return Err(WordsError {
            problem,
            grammar: "FILE [pos=x,y,z] [turn=yaw,pitch,roll] [scale=s] [time=seconds] [clip=n] [swing=yaw,pitch,roll] [hinge=x,y,z]",
        });
    }
    Ok((file.to_owned(), stance_from_text(&words.join(" "))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stances_are_read_with_what_is_left_out_at_rest() {
        assert_eq!(stance_from_text("").unwrap(), Stance::default());
        let stance = stance_from_text(
            "pos=1,2,3 turn=90,0,-5 scale=0.5 time=2.5 clip=2 swing=80,0,0 hinge=-0.4,0,0.02",
        )
        .unwrap();
        let expected = Stance {
            position_m: [1.0, 2.0, 3.0],
            turn_deg: [90.0, 0.0, -5.0],
            scale: 0.5,
            time_s: 2.5,
            clip: 1,
            swing_deg: [80.0, 0.0, 0.0],
            hinge_m: [-0.4, 0.0, 0.02],
        };
        assert_eq!(stance, expected);
        assert_eq!(stance_from_text(&stance_to_text(&stance)), Ok(stance));
        assert_eq!(stance_to_text(&Stance::default()), "");
        for wrong in [
            "pos=1,2",
            "hinge=1e7,0,0",
            "swing=1",
            "scale=0",
            "scale=-1",
            "clip=0",
            "clip=1.5",
            "time=-1",
            "turn=nan,0,0",
            "pos=0,-2e6,0",
            "at=1,2,3",
            "pos",
        ] {
            let error = stance_from_text(wrong).unwrap_err().to_string();
            assert!(error.contains("turn=yaw,pitch,roll"), "{wrong}: {error}");
        }
    }

    #[test]
    fn names_of_files_may_have_spaces_and_signs() {
        let (file, stance) = object_from_text(" my chair=1.glb pos=1,0,0  scale=2").unwrap();
        assert_eq!(
            (file.as_str(), stance.position_m, stance.scale),
            ("my chair=1.glb", [1.0, 0.0, 0.0], 2.0)
        );
        assert_eq!(object_from_text("chair.glb").unwrap().0, "chair.glb");
        for wrong in ["", "  ", "pos=1,0,0", "a.glb pos=1"] {
            assert!(object_from_text(wrong).is_err(), "{wrong}");
        }
    }
}
