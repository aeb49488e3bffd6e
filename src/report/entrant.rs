//! Entrants of a report: techniques, or `auto`, alone or with a denoiser.

use std::{fmt, iter};

use serde::{Serialize, Serializer};

use crate::settings::{Denoise, Settings, Technique};

/// A technique or `auto`, and the denoiser of its images. Its name is that of the technique; with a denoiser,
/// `TECHNIQUE+DENOISER`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Entrant {
    /// How light is computed. `None` for `auto`, which chooses a technique for each budget.
    pub technique: Option<Technique>,
    /// The denoiser.
    pub denoise: Denoise,
}

impl Entrant {
    /// The name of the choice of a technique for each budget.
    pub const AUTO: &str = "auto";

    /// All entrants that are possible, in the order of reports: by technique, `auto` last, each raw image first.
    pub fn all() -> impl Iterator<Item = Entrant> {
        Technique::all().map(Some).chain([None]).flat_map(|technique| {
            let denoised = Entrant::denoisers().map(move |denoise| Entrant { technique, denoise });
            iter::once(Entrant { technique, denoise: Denoise::None }).chain(denoised)
        })
    }

    /// The denoisers that an entrant can have.
    pub fn denoisers() -> impl Iterator<Item = Denoise> {
        Denoise::ALL.into_iter().filter(|denoise| *denoise != Denoise::None)
    }

    /// A technique alone.
    pub const fn raw(technique: Technique) -> Entrant {
        Entrant { technique: Some(technique), denoise: Denoise::None }
    }

    /// The entrant that renders with these settings.
    pub fn of(settings: &Settings) -> Entrant {
        Entrant { technique: Some(settings.technique), denoise: settings.image.denoise }
    }

    /// Whether it chooses a technique for each budget.
    pub fn is_automatic(self) -> bool {
        self.technique.is_none()
    }

    /// Whether its images are denoised.
    pub fn is_denoised(self) -> bool {
        self.denoise != Denoise::None
    }
}

impl fmt::Display for Entrant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.technique {
            Some(technique) => write!(f, "{technique}")?,
            None => f.write_str(Entrant::AUTO)?,
        }
        match self.denoise {
            Denoise::None => Ok(()),
            denoise => write!(f, "+{denoise}"),
        }
    }
}

impl Serialize for Entrant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
