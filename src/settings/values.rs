//! The values of settings as text, by which errors say how two renders differ.

use std::collections::BTreeMap;

use serde_json::Value;

use super::Settings;

/// The value of each setting, by its name in statistics (docs/statistics.md).
pub(crate) type SettingValues = BTreeMap<String, String>;

impl Settings {
    /// The value of each setting.
    pub(crate) fn values(&self) -> SettingValues {
        let text = |value: Value| match value {
            Value::Null => "unset".to_owned(),
            Value::String(text) => text,
            other => other.to_string(),
        };
        // By way of text, because a `Value` widens an f32: 0.1 would become 0.10000000149011612.
        let fields = serde_json::to_string(self).and_then(|json| serde_json::from_str(&json));
        let Ok(Value::Object(fields)) = fields else { return SettingValues::new() };
        let mut values: SettingValues = fields.into_iter().map(|(name, value)| (name, text(value))).collect();
        if self.image.spp == Settings::UNLIMITED_SPP {
            values.insert("spp".into(), "unlimited".into());
        }
        values
    }
}

/// How `values` differ from those `expected`: "seed is 1, not 0". `None` if they do not.
pub(crate) fn difference(values: &SettingValues, expected: &SettingValues) -> Option<String> {
    let differs = |(name, value): (&String, &String)| {
        let other = expected.get(name).filter(|other| *other != value)?;
        Some(format!("{name} is {value}, not {other}"))
    };
    let differences: Vec<String> = values.iter().filter_map(differs).collect();
    (!differences.is_empty()).then(|| differences.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Sampling;

    /// All differences are named, from all groups of settings, with values as users write them.
    #[test]
    fn differences_are_named() {
        let settings = Settings::default();
        assert_eq!(difference(&settings.values(), &settings.values()), None);
        let other = settings.clone().with(|s| {
            (s.image.seed, s.image.spp, s.image.sampling) = (7, Settings::UNLIMITED_SPP, Sampling::Adaptive);
            s.indirect.photons = Some(1000);
            s.light_scale = 0.1;
        });
        let all = "flux_photons is 1000, not unset; light_scale is 0.1, not 1.0; sampling is adaptive, not uniform; \
             seed is 7, not 0; spp is unlimited, not 16";
        assert_eq!(difference(&other.values(), &settings.values()).unwrap(), all);
    }
}
