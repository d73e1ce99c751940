//! Values that a setting can have: numbers, and words of a list.

use serde_json::{Number, Value};

/// A value in a settings object.
pub trait SettingValue: Clone {
    /// Type in words, for errors.
    const WANTED: &'static str;

    /// Reads JSON of the right type.
    fn read(value: &Value) -> Option<Self>;

    /// As JSON.
    fn write(&self) -> Value;
}

impl SettingValue for u32 {
    const WANTED: &'static str = "a whole number";

    fn read(value: &Value) -> Option<Self> {
        value.as_u64().and_then(|number| number.try_into().ok())
    }

    fn write(&self) -> Value {
        (*self).into()
    }
}

impl SettingValue for f32 {
    const WANTED: &'static str = "a number";

    fn read(value: &Value) -> Option<Self> {
        let number = value.as_f64()? as f32;
        number.is_finite().then_some(number)
    }

    /// The shortest decimal that reads back as the same number.
    fn write(&self) -> Value {
        let decimal = self.to_string().parse().ok().and_then(Number::from_f64);
        decimal.map_or(Value::Null, Value::Number)
    }
}

/// A setting of words: an enum whose values have names.
///
/// ```
/// # use lightkiln_proto::{settings::SettingValue, setting_words};
/// setting_words! {
///     /// Structure of a field.
///     pub enum Structure { Bricks = "bricks", Tetrahedra = "tetrahedra" }
/// }
/// assert_eq!(Structure::read(&"bricks".into()), Some(Structure::Bricks));
/// assert_eq!(Structure::read(&"cubes".into()), None);
/// ```
#[macro_export]
macro_rules! setting_words {
    ($(#[doc = $doc:literal])* $visible:vis enum $name:ident { $($value:ident = $word:literal),+ $(,)? }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $visible enum $name {
            $(#[doc = concat!("`", $word, "`.")] $value,)+
        }

        impl $crate::settings::SettingValue for $name {
            const WANTED: &'static str = concat!("one of:", $(" ", $word),+);

            fn read(value: &$crate::settings::Json) -> Option<Self> {
                match value.as_str()? {
                    $($word => Some(Self::$value),)+
                    _ => None,
                }
            }

            fn write(&self) -> $crate::settings::Json {
                match self { $(Self::$value => $word.into(),)+ }
            }
        }
    };
}
