//! Values of options: what they may be, and how they are read.

use std::ffi::{OsStr, OsString};
use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command};
use glam::DVec3;
use penumbra::internal::report::entrant::Entrant;
use penumbra::internal::scene::linear_from_srgb;
use penumbra::internal::scene::{Focus, MAX_BLADES};
use penumbra::settings::{Background, Crop, Denoise, LightSampling, Sampling};
use penumbra::{Aov, Technique};

/// A technique; `None` for `auto`.
#[derive(Clone, Copy)]
pub struct TechniqueChoice(pub Option<Technique>);

/// One of the techniques, by name, or `auto`.
pub fn technique_or_auto() -> impl TypedValueParser<Value = TechniqueChoice> {
    let help = "shadow-photons, or path if --time is too short for photons";
    let auto = PossibleValue::new("auto").help(help);
    PossibleValuesParser::new(std::iter::once(auto).chain(Technique::all().map(possible)))
        .map(|name| TechniqueChoice(name.parse().ok()))
}

fn possible(technique: Technique) -> PossibleValue {
    PossibleValue::new(technique.name()).help(technique.help())
}

/// A technique by name, alone or with a denoiser: `TECHNIQUE+DENOISER`.
#[derive(Clone)]
pub struct EntrantParser;

impl TypedValueParser for EntrantParser {
    type Value = Entrant;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &OsStr,
    ) -> std::result::Result<Entrant, clap::Error> {
        let text = value.to_string_lossy();
        let (technique, denoiser) = text.split_once('+').map_or((&*text, None), |(name, with)| (name, Some(with)));
        let TechniqueChoice(technique) = technique_or_auto().parse(command, arg, OsString::from(technique))?;
        let Some(denoiser) = denoiser else { return Ok(Entrant { technique, denoise: Denoise::None }) };
        let denoisers = PossibleValuesParser::new(Entrant::denoisers().map(Denoise::name));
        let denoise = denoisers.try_map(|name| name.parse()).parse(command, arg, OsString::from(denoiser))?;
        Ok(Entrant { technique, denoise })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        technique_or_auto().possible_values().map(|values| Box::new(values.collect::<Vec<_>>().into_iter()) as _)
    }
}

/// One of `all`, by name, each with its help.
fn by_name<T, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
    help: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T>
where
    T: Copy + FromStr<Err = String> + Send + Sync + 'static,
{
    let values = all.map(|value| PossibleValue::new(name(value)).help(help(value)));
    PossibleValuesParser::new(values).try_map(|name| name.parse())
}

/// One of the strategies of light sampling.
pub fn light_samplings() -> impl TypedValueParser<Value = LightSampling> {
    by_name(LightSampling::ALL, LightSampling::name, |strategy| match strategy {
        LightSampling::All => "all lights",
        LightSampling::Uniform => "a few lights, with equal probability",
        LightSampling::Power => "a few lights: with probability 1/2 by power, else with equal probability",
        LightSampling::Contribution => "a few lights, by the light that each would send to the point without occluders",
        LightSampling::Zones => "a few of the lights whose photons reach the zone of the point",
    })
}

/// One of the distributions of samples over the pixels.
pub fn samplings() -> impl TypedValueParser<Value = Sampling> {
    by_name(Sampling::ALL, Sampling::name, |sampling| match sampling {
        Sampling::Uniform => "--spp samples for every pixel",
        Sampling::Adaptive => {
            "--spp samples per pixel on average: up to eight times as many where there is noise, and as few as half as \
             many where there is none"
        }
    })
}

/// One of the denoisers.
pub fn denoisers() -> impl TypedValueParser<Value = Denoise> {
    by_name(Denoise::ALL, Denoise::name, |denoise| match denoise {
        Denoise::Auto => "the mixture of the raw image and all available denoisers with the smallest estimated error",
        Denoise::None => "no denoiser",
        Denoise::Statistical => "the statistical denoiser alone, which needs no library",
        Denoise::Oidn => "Open Image Denoise alone",
    })
}

/// A list of groups of channels, separated by commas.
#[derive(Clone, Default)]
pub struct AovList(pub Vec<Aov>);

impl AovList {
    pub fn help() -> String {
        let names = Aov::ALL.map(Aov::name).join(", ");
        format!("Channels in addition to the image, for .exr: {names}, separated by commas; or all [default: none]")
    }
}

impl FromStr for AovList {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == "all" {
            return Ok(AovList(Aov::ALL.into()));
        }
        let mut aovs = text.split(',').map(|name| name.trim().parse()).collect::<std::result::Result<Vec<Aov>, _>>()?;
        aovs.sort();
        aovs.dedup();
        Ok(AovList(aovs))
    }
}

/// A number that is not NaN or infinite.
pub fn finite<T: FromStr + Into<f64> + Copy>(text: &str) -> std::result::Result<T, String> {
    let number = text.parse::<T>().ok().filter(|number| (*number).into().is_finite());
    number.ok_or_else(|| "it must be a finite number".into())
}

/// A number above 0.
pub fn positive(text: &str) -> std::result::Result<f64, String> {
    finite(text).ok().filter(|x| *x > 0.0).ok_or_else(|| "it must be a finite number, more than 0".into())
}

/// Numbers separated by commas.
fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// The azimuth and the elevation of a view, in degrees.
pub fn direction(text: &str) -> std::result::Result<[f32; 2], String> {
    let is_direction = |[azimuth, elevation]: &[f32; 2]| azimuth.is_finite() && elevation.abs() <= 90.0;
    let direction = numbers(text).filter(is_direction);
    direction.ok_or_else(|| "it must be two numbers, as in 30,15, the second from -90 to 90".into())
}

/// A position.
pub fn position(text: &str) -> std::result::Result<DVec3, String> {
    let position = numbers(text).map(DVec3::from_array).filter(|position| position.is_finite());
    position.ok_or_else(|| "it must be three finite numbers, as in 1,0.5,-2".into())
}

pub fn up(text: &str) -> std::result::Result<DVec3, String> {
    let up = position(text).ok().filter(|up| up.try_normalize().is_some());
    up.ok_or_else(|| "it must be three finite numbers that are not all 0, as in 0,1,0".into())
}

pub fn field_of_view(text: &str) -> std::result::Result<f64, String> {
    positive(text).ok().filter(|fov| *fov < 180.0).ok_or_else(|| "it must be more than 0 and less than 180".into())
}

pub fn focus(text: &str) -> std::result::Result<Focus, String> {
    match text {
        "auto" => Ok(Focus::Auto),
        _ => positive(text).map(Focus::Distance).map_err(|problem| problem + ", or auto"),
    }
}

pub fn blades(text: &str) -> std::result::Result<u32, String> {
    let blades = text.parse().ok().filter(|blades| *blades == 0 || (3..=MAX_BLADES).contains(blades));
    blades.ok_or_else(|| format!("it must be 0, or from 3 to {MAX_BLADES}"))
}

pub fn crop(text: &str) -> std::result::Result<Crop, String> {
    let parts = numbers(text).map(|[x, y, width, height]| Crop { x, y, width, height });
    parts.ok_or_else(|| "it must be four whole numbers of pixels, as in 0,0,64,48".into())
}

const BACKGROUND_PROBLEM: &str =
    "it must be environment, transparent, a colour as #RRGGBB or #RGB, or three numbers that are 0 or more";

pub fn background(text: &str) -> std::result::Result<Background, String> {
    match text {
        "environment" => return Ok(Background::Environment),
        "transparent" => return Ok(Background::Transparent),
        _ => {}
    }
    let linear = || numbers(text).filter(|colour: &[f32; 3]| colour.iter().all(|x| x.is_finite() && *x >= 0.0));
    let coded = || {
        // `from_str_radix` would take a sign for a digit.
        let digits = text.strip_prefix('#').filter(|digits| digits.chars().all(|digit| digit.is_ascii_hexdigit()))?;
        let digits = match digits.len() {
            3 => digits.chars().flat_map(|digit| [digit; 2]).collect(),
            6 => digits.to_owned(),
            _ => return None,
        };
        let code = u32::from_str_radix(&digits, 16).ok()?.to_be_bytes();
        Some([1, 2, 3].map(|i| linear_from_srgb(f32::from(code[i]) / 255.0)))
    };
    coded().or_else(linear).map(Background::Colour).ok_or_else(|| BACKGROUND_PROBLEM.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colours of three digits are those of six with each digit doubled. Signs and other lengths are refused.
    #[test]
    fn backgrounds_are_read() {
        let colour = |text: &str| match background(text) {
            Ok(Background::Colour(colour)) => Some(colour),
            _ => None,
        };
        assert_eq!(colour("#f80"), colour("#FF8800"));
        assert_eq!(colour("#0f0"), Some([0.0, 1.0, 0.0]));
        assert_eq!(colour("0,2.5,0"), Some([0.0, 2.5, 0.0]));
        for wrong in ["#", "#12", "#+12345", "#12345g", "#1234567", "1,2", "-1,0,0", "inf,0,0", "white"] {
            assert_eq!(background(wrong).unwrap_err(), BACKGROUND_PROBLEM, "{wrong}");
        }
    }
}
