//! Macros that make groups of settings and the settings of a kind, and the checks that they share.

use serde_json::Value;

use super::{Map, Preset, SettingRow, SettingsError};
use crate::nearest::nearest;

/// Makes a group of settings: a struct, its rows, its checks. A field is `name: type = [draft, medium, high], check, "range"`.
#[macro_export]
macro_rules! settings_group {
    (
        $(#[doc = $about:literal])* $group:ident {
            $( $(#[doc = $doc:literal])* $name:ident : $kind:ty = [$draft:expr, $medium:expr, $high:expr], $check:expr, $range:literal; )*
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $group {
            $( $(#[doc = $doc])* pub $name: $kind, )*
        }

        impl $crate::settings::SettingsGroup for $group {
            fn rows() -> Vec<$crate::settings::SettingRow> {
                use $crate::settings::SettingValue as _;
                vec![$( $crate::settings::SettingRow {
                    name: stringify!($name),
                    range: $range,
                    presets: [<$kind>::write(&$draft), <$kind>::write(&$medium), <$kind>::write(&$high)],
                    effect: concat!($($doc),*),
                }, )*]
            }

            fn read(
                given: &$crate::settings::Map,
                preset: $crate::settings::Preset,
            ) -> Result<Self, $crate::settings::SettingsError> {
                use $crate::settings::SettingValue as _;
                $(
                    let $name: $kind = match given.get(stringify!($name)) {
                        None => [$draft, $medium, $high][preset.index()],
                        Some(value) => <$kind>::read(value).ok_or_else(|| $crate::settings::SettingsError::Type {
                            name: stringify!($name),
                            value: value.to_string(),
                            wanted: <$kind>::WANTED,
                        })?,
                    };
                    let is_allowed: fn($kind) -> bool = $check;
                    if !is_allowed($name) {
                        let value = $name.write().to_string();
                        let (name, range) = (stringify!($name), $range);
                        return Err($crate::settings::SettingsError::OutOfRange { name, value, range });
                    }
                )*
                Ok(Self { $($name),* })
            }

            fn write(&self, to: &mut $crate::settings::Map) {
                use $crate::settings::SettingValue as _;
                $( to.insert(stringify!($name).to_owned(), self.$name.write()); )*
            }
        }

        $crate::settings_as_json!($group);
    };
}

/// Makes the settings of a kind of bake from groups: the preset, then one field per group.
#[macro_export]
macro_rules! kind_settings {
    ($(#[doc = $about:literal])* $settings:ident of $kind:expr => { $( $(#[doc = $doc:literal])* $field:ident : $group:ty, )* }) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $settings {
            /// Preset that the rest started from.
            pub preset: $crate::settings::Preset,
            $( $(#[doc = $doc])* pub $field: $group, )*
        }

        impl $settings {
            /// Every setting of the kind, its preset first.
            pub fn rows() -> Vec<$crate::settings::SettingRow> {
                use $crate::settings::SettingsGroup as _;
                let mut rows = vec![$crate::settings::preset_row()];
                $( rows.extend(<$group>::rows()); )*
                rows
            }

            /// Reads settings from a request; `null` means all defaults.
            pub fn from_json(json: &$crate::settings::Json) -> Result<Self, $crate::settings::SettingsError> {
                use $crate::settings::SettingsGroup as _;
                let given = $crate::settings::check_keys(json, $kind, &Self::rows())?;
                let preset = $crate::settings::preset_of(&given)?;
                Ok(Self { preset, $( $field: <$group>::read(&given, preset)?, )* })
            }

            /// All settings as JSON, as tasks and manifests state them.
            pub fn stated(&self) -> $crate::settings::Json {
                let mut object = $crate::settings::Map::new();
                $crate::settings::SettingsGroup::write(self, &mut object);
                $crate::settings::Json::Object(object)
            }
        }

        impl $crate::settings::SettingsGroup for $settings {
            fn rows() -> Vec<$crate::settings::SettingRow> {
                Self::rows()
            }

            fn read(
                given: &$crate::settings::Map,
                _: $crate::settings::Preset,
            ) -> Result<Self, $crate::settings::SettingsError> {
                if !given.contains_key("preset") {
                    return Err($crate::settings::SettingsError::NoPreset);
                }
                Self::from_json(&$crate::settings::Json::Object(given.clone()))
            }

            fn write(&self, to: &mut $crate::settings::Map) {
                let (_, name) = $crate::settings::Preset::ALL[self.preset.index()];
                to.insert("preset".to_owned(), name.into());
                $( self.$field.write(to); )*
            }
        }

        $crate::settings_as_json!($settings);
    };
}

/// Serde by way of the checked object: tasks and manifests state settings in full, and reading checks them once more.
#[doc(hidden)]
#[macro_export]
macro_rules! settings_as_json {
    ($settings:ty) => {
        impl $crate::settings::Serialize for $settings {
            fn serialize<S: $crate::settings::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let mut object = $crate::settings::Map::new();
                $crate::settings::SettingsGroup::write(self, &mut object);
                $crate::settings::Serialize::serialize(&object, serializer)
            }
        }

        impl<'de> $crate::settings::Deserialize<'de> for $settings {
            fn deserialize<D: $crate::settings::Deserializer<'de>>(
                deserializer: D,
            ) -> Result<Self, D::Error> {
                let object =
                    <$crate::settings::Map as $crate::settings::Deserialize>::deserialize(deserializer)?;
                $crate::settings::stated(&object).map_err($crate::settings::custom_error::<D>)
            }
        }
    };
}

/// The row of the preset itself.
pub fn preset_row() -> SettingRow {
    SettingRow {
        name: "preset",
        range: "draft, medium or high",
        presets: Preset::ALL.map(|(_, name)| name.into()),
        effect: " How much work to spend: sets every other setting that is not set itself.",
    }
}

/// The object of settings; errs on a key that no row has. `null` is an empty object.
pub fn check_keys(json: &Value, kind: &'static str, rows: &[SettingRow]) -> Result<Map, SettingsError> {
    let found = match json {
        Value::Null => return Ok(Map::new()),
        Value::Object(given) => {
            return match given.keys().find(|key| rows.iter().all(|row| row.name != key.as_str())) {
                None => Ok(given.clone()),
                Some(name) => {
                    let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
                    Err(SettingsError::Unknown {
                        hint: nearest(name, names.iter().copied())
                            .map(|hint| format!(" (do you mean '{hint}'?)"))
                            .unwrap_or_default(),
                        name: name.clone(),
                        kind,
                        known: names.join(", "),
                    })
                }
            };
        }
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
    };
    Err(SettingsError::NoObject { found })
}

/// The preset that an object of settings names; medium unless it names one.
pub fn preset_of(given: &Map) -> Result<Preset, SettingsError> {
    let Some(value) = given.get("preset") else { return Ok(Preset::default()) };
    let named = Preset::ALL.into_iter().find(|(_, name)| value == name);
    named.map(|(preset, _)| preset).ok_or_else(|| SettingsError::OutOfRange {
        name: "preset",
        value: value.to_string(),
        range: "draft, medium or high",
    })
}
