//! A bake's settings from all their sources: defaults < file < environment < command line.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use lightkiln_proto::api::NewBake;
use lightkiln_proto::kinds::{Kind, Kinds};
use serde_json::{Map, Value};

use crate::failure::{Failure, Result};

/// Environment variables of this prefix and a setting's name in capitals set it.
const ENVIRONMENT_PREFIX: &str = "KILN_SET_";
/// Setting that every kind has.
pub const PRESET: &str = "preset";
/// Environment variable that names the preset.
const PRESET_VARIABLE: &str = "KILN_PRESET";
/// Environment variable that names the kind of bake.
const KIND_VARIABLE: &str = "KILN_KIND";

/// How much work a bake spends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PresetName {
    /// A look within seconds: coarse texels, noisy.
    Draft,
    /// Everyday bakes.
    Medium,
    /// Final bakes.
    High,
}

/// A kind of bake and what differs from its defaults.
#[derive(Clone)]
pub struct Wanted {
    /// Kind.
    pub kind: &'static dyn Kind,
    /// Settings, checked, as a request carries them.
    pub settings: Value,
}

impl Wanted {
    /// A kind with settings, once these are checked.
    pub fn new(kind: &'static dyn Kind, settings: Map<String, Value>) -> Result<Self> {
        let settings = Value::Object(settings);
        kind.resolve(&settings).map_err(|error| {
            let step =
                format!("'kiln settings --kind {}', which lists every setting with its range", kind.name());
            Failure::bad_input("the settings cannot be used").caused_by(&error).try_this(step)
        })?;
        Ok(Self { kind, settings })
    }

    /// Writes kind and settings into a request.
    pub fn set(&self, bake: &mut NewBake) {
        self.kind.name().clone_into(&mut bake.kind);
        bake.settings.clone_from(&self.settings);
    }
}

/// Kind and settings on the command line.
#[derive(Args, Clone, Debug, Default)]
pub struct SettingsArguments {
    /// Kind of bake; 'kiln settings --kind KIND' lists its settings [env: KILN_KIND; default: the first that it lists]
    #[arg(long)]
    pub kind: Option<String>,
    /// How much work to spend: draft, medium (the default) or high [env: KILN_PRESET]
    #[arg(long)]
    pub preset: Option<PresetName>,
    /// Sets one setting, e.g. --set transport_rays=512; may be given often [env: KILN_SET_<SETTING>]
    #[arg(long = "set", value_name = "SETTING=VALUE")]
    pub set: Vec<String>,
    /// JSON file of settings, e.g. {"preset": "draft", "texel_m": 0.2}
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
}

impl SettingsArguments {
    /// The kind, and what differs from its defaults.
    pub fn resolve(&self, kinds: &Kinds) -> Result<Wanted> {
        let environment = std::env::vars_os().filter_map(|(name, value)| {
            Some((name.into_string().ok()?, value.to_string_lossy().into_owned()))
        });
        self.resolve_with(kinds, environment)
    }

    fn resolve_with(
        &self,
        kinds: &Kinds,
        environment: impl Iterator<Item = (String, String)>,
    ) -> Result<Wanted> {
        let mut kind = self.kind.clone();
        let mut settings = self.settings.as_deref().map_or_else(|| Ok(Map::new()), read_file)?;
        for (name, value) in environment {
            if name == KIND_VARIABLE {
                kind.get_or_insert(value);
            } else if name == PRESET_VARIABLE {
                settings.insert(PRESET.into(), Value::String(value));
            } else if let Some(setting) = name.strip_prefix(ENVIRONMENT_PREFIX) {
                settings.insert(setting.to_lowercase(), parse_value(&value));
            }
        }
        if let Some(preset) = self.preset {
            let name = preset.to_possible_value().map(|value| value.get_name().to_owned());
            settings.insert(PRESET.into(), name.into());
        }
        assign(&mut settings, "--set", &self.set)?;
        Wanted::new(kind_named(kinds, kind.as_deref().unwrap_or_default())?, settings)
    }
}

/// Sets each `SETTING=VALUE` that an option gives.
pub fn assign(settings: &mut Map<String, Value>, option: &str, given: &[String]) -> Result<()> {
    for assignment in given {
        let Some((name, value)) = assignment.split_once('=') else {
            let wrong = format!("{option} '{assignment}' is not of the form SETTING=VALUE");
            return Err(Failure::bad_input(wrong).try_this(format!("e.g. {option} transport_rays=512")));
        };
        settings.insert(name.trim().to_owned(), parse_value(value.trim()));
    }
    Ok(())
}

/// The kind of that name; the default for an empty one.
pub fn kind_named(kinds: &Kinds, name: &str) -> Result<&'static dyn Kind> {
    kinds
        .named(name)
        .map_err(|error| Failure::bad_input(error.to_string()).try_this("--kind with one of them"))
}

/// Numbers and words as JSON has them; anything else is a text.
fn parse_value(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
}

fn read_file(path: &Path) -> Result<Map<String, Value>> {
    let failed = |what: &str| Failure::bad_input(format!("the settings file {} {what}", path.display()));
    let text = fs::read_to_string(path).map_err(|error| failed("cannot be read").caused_by(&error))?;
    let example = "write one JSON object, e.g. {\"preset\": \"draft\"}";
    let value: Value = serde_json::from_str(&text)
        .map_err(|error| failed("is not JSON").caused_by(&error).try_this(example))?;
    match value {
        Value::Object(settings) => Ok(settings),
        _ => Err(failed("holds no JSON object").try_this(example)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn environment(pairs: &[(&str, &str)]) -> impl Iterator<Item = (String, String)> {
        pairs
            .iter()
            .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
            .collect::<Vec<_>>()
            .into_iter()
    }

    #[test]
    fn flag_wins_over_environment_over_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("settings.json");
        fs::write(&file, r#"{"preset": "high", "sky_parts": 16, "transport_rays": 32, "rank_max": 8}"#)
            .unwrap();
        let arguments = SettingsArguments {
            set: vec!["sky_parts=64".into()],
            settings: Some(file),
            ..Default::default()
        };
        let variables =
            environment(&[("KILN_SET_SKY_PARTS", "32"), ("KILN_SET_TRANSPORT_RAYS", "64"), ("HOME", "/")]);
        let resolved = arguments.resolve_with(&Kinds::new(), variables).unwrap().settings;
        assert_eq!(resolved, json!({"preset": "high", "sky_parts": 64, "transport_rays": 64, "rank_max": 8}));
    }

    #[test]
    fn preset_comes_from_the_environment_unless_the_flag_is_given() {
        let variables = || environment(&[("KILN_PRESET", "draft")]);
        let resolved =
            SettingsArguments::default().resolve_with(&Kinds::new(), variables()).unwrap().settings;
        assert_eq!(resolved, json!({"preset": "draft"}));
        let flagged = SettingsArguments { preset: Some(PresetName::High), ..Default::default() };
        assert_eq!(
            flagged.resolve_with(&Kinds::new(), variables()).unwrap().settings,
            json!({"preset": "high"})
        );
    }

    #[test]
    fn wrong_settings_are_bad_input_and_named() {
        for (set, named) in
            [("sky_parts", "SETTING=VALUE"), ("sky_parts=99", "sky_parts = 99"), ("colour=1", "colour")]
        {
            let arguments = SettingsArguments { set: vec![set.into()], ..Default::default() };
            let failure = arguments.resolve_with(&Kinds::new(), environment(&[])).err().unwrap();
            assert_eq!(failure.exit(), crate::failure::Exit::BadInput);
            assert!(failure.to_string().contains(named), "{failure}");
        }
    }

    #[test]
    fn kind_comes_from_the_flag_before_the_environment_and_an_unknown_one_is_named() {
        let resolve = |flag: Option<&str>, variable: &str| {
            let arguments = SettingsArguments { kind: flag.map(str::to_owned), ..Default::default() };
            arguments.resolve_with(&Kinds::new(), environment(&[("KILN_KIND", variable)]))
        };
        assert_eq!(resolve(None, "sh").unwrap().kind.name(), "sh");
        assert_eq!(resolve(Some("prt"), "sh").unwrap().kind.name(), "prt");
        let failure = resolve(Some("photons"), "sh").err().unwrap().to_string();
        assert!(failure.contains("photons") && failure.contains("prt"), "{failure}");
    }
}
