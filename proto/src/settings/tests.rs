//! Groups and kinds of settings: defaults by preset, checks, and the way through JSON.

use serde_json::json;

use super::*;
use crate::{kind_settings, setting_words, settings_group};

setting_words! {
    /// Colour of a test.
    pub enum Colour { Red = "red", Blue = "blue" }
}

settings_group! {
    /// A group of a number and a word.
    Own {
        /// Size. More → larger.
        size_m: f32 = [0.1, 0.2, 0.3], |v| v > 0.0, "above 0 m";
        /// Colour.
        colour: Colour = [Colour::Red, Colour::Red, Colour::Blue], |_| true, "red or blue";
    }
}

kind_settings! {
    /// Settings of a test's kind.
    Settings of "test" => {
        /// Rays.
        transport: TransportSettings,
        /// Its own.
        own: Own,
    }
}

#[test]
fn preset_fills_in_the_rest_and_null_is_medium() {
    let high = Settings::from_json(&json!({ "preset": "high", "transport_rays": 64 })).unwrap();
    assert_eq!((high.transport.transport_rays, high.transport.emitter_rays), (64, 256));
    assert_eq!((high.own.size_m, high.own.colour), (0.3, Colour::Blue));
    assert_eq!(Settings::from_json(&json!(null)).unwrap().preset, Preset::Medium);
}

#[test]
fn rows_tell_numbers_and_words_by_preset() {
    let rows = Settings::rows();
    let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
    assert_eq!(names, ["preset", "transport_rays", "emitter_rays", "size_m", "colour"]);
    assert_eq!(rows[3].presets, [json!(0.1), json!(0.2), json!(0.3)]);
    assert_eq!(rows[4].presets, [json!("red"), json!("red"), json!("blue")]);
}

#[test]
fn stated_settings_come_back_and_must_name_their_preset() {
    let settings = Settings::from_json(&json!({ "preset": "draft", "size_m": 0.02 })).unwrap();
    let mut stated = settings.stated();
    assert_eq!(stated, serde_json::to_value(&settings).unwrap());
    assert_eq!(stated["size_m"], json!(0.02), "the shortest decimal");
    assert_eq!(serde_json::from_value::<Settings>(stated.clone()).unwrap(), settings);
    // A setting that an older bake did not know has its preset's value.
    stated.as_object_mut().unwrap().remove("colour");
    assert_eq!(serde_json::from_value::<Settings>(stated.clone()).unwrap(), settings);
    stated.as_object_mut().unwrap().remove("preset");
    assert!(serde_json::from_value::<Settings>(stated).is_err());
}

#[test]
fn group_in_parameters_is_stated_in_full_and_has_no_other_key() {
    let own = Settings::from_json(&json!({ "preset": "draft" })).unwrap().own;
    let stated = serde_json::to_value(&own).unwrap();
    assert_eq!(serde_json::from_value::<Own>(stated.clone()).unwrap(), own);
    let error = |change: fn(&mut Map)| {
        let mut stated = stated.clone();
        change(stated.as_object_mut().unwrap());
        serde_json::from_value::<Own>(stated).unwrap_err().to_string()
    };
    let lacking = error(|stated| drop(stated.remove("size_m")));
    assert!(lacking.contains("lack 'size_m'"), "{lacking}");
    let newer = error(|stated| drop(stated.insert("shape".into(), json!(1))));
    assert!(newer.contains("'shape'"), "{newer}");
}

#[test]
fn unknown_keys_wrong_types_and_ranges_are_refused_by_name() {
    let error = |json| Settings::from_json(&json).unwrap_err();
    assert!(matches!(error(json!({ "texel": 1 })), SettingsError::Unknown { name, .. } if name == "texel"));
    assert!(matches!(error(json!({ "size_m": 0 })), SettingsError::OutOfRange { name: "size_m", .. }));
    assert!(matches!(error(json!({ "size_m": f64::MAX })), SettingsError::Type { name: "size_m", .. }));
    assert!(matches!(
        error(json!({ "transport_rays": "abc" })),
        SettingsError::Type { name: "transport_rays", .. }
    ));
    assert!(matches!(error(json!({ "transport_rays": 1.5 })), SettingsError::Type { .. }));
    assert!(matches!(
        error(json!({ "colour": "green" })),
        SettingsError::Type { wanted: "one of: red blue", .. }
    ));
    assert!(matches!(error(json!({ "preset": "best" })), SettingsError::OutOfRange { name: "preset", .. }));
    assert!(matches!(error(json!([])), SettingsError::NoObject { .. }));
}
