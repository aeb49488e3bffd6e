//! `penumbra stress`.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use penumbra::Result;
use penumbra::internal::render::film;
use penumbra::internal::report::plot;
use penumbra::internal::stress::{FAMILIES, Family, Reading, breakdown};

use super::folder::make_folder;
use super::options::DeviceOptions;
use super::{Ending, print, say, write_text};

#[derive(clap::Args)]
pub struct Arguments {
    /// Families to measure [default: all]
    #[arg(value_name = "FAMILY", value_parser = families())]
    families: Vec<&'static Family>,

    /// Folder for a chart of each family, as .svg
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    output: Option<PathBuf>,

    #[command(flatten)]
    device: DeviceOptions,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let families = if arguments.families.is_empty() { &FAMILIES[..] } else { &arguments.families };
    let file = |family: &Family| arguments.output.as_ref().map(|folder| folder.join(format!("{}.svg", family.name)));
    if let Some(folder) = &arguments.output {
        make_folder(folder)?;
    }
    families.iter().filter_map(|family| file(family)).try_for_each(film::check_target)?;
    let gpu = arguments.device.open()?;
    for family in families {
        print(&format!("{}: {}\n{}: {}\n", family.name, family.title, "deviation", family.deviation))?;
        let mut curves = Vec::new();
        for series in family.series {
            print(&format!("\n{:>12}  {:>9}  {:>9}  {}\n", "value", "deviation", "bound", series.name))?;
            let mut lines = Ok(());
            let readings = series.run(&gpu, series.values, |reading| {
                if lines.is_ok() {
                    lines = print(&line(reading));
                }
            })?;
            lines?;
            let held = match breakdown(&readings) {
                None => "within the bound throughout".to_owned(),
                Some(value) => format!("leaves the bound at {value:.0e}"),
            };
            print(&format!("{held}\n"))?;
            curves.push((series, readings));
        }
        print("\n")?;
        if let Some(path) = file(family) {
            let chart = plot::stress(family, &curves)?;
            write_text(&path, &chart)?;
            say(format_args!("wrote {}", path.display()));
        }
    }
    Ok(Ending::Done)
}

/// One of the families, by name.
fn families() -> impl TypedValueParser<Value = &'static Family> {
    let values = FAMILIES.map(|family| {
        let [from, to] = family.range();
        PossibleValue::new(family.name).help(format!("{}, {from:.0e} to {to:.0e}", family.parameter))
    });
    PossibleValuesParser::new(values).try_map(|name| Family::named(&name))
}

fn line(reading: &Reading) -> String {
    let end = if reading.holds() { "" } else { "  beyond the bound" };
    match &reading.outcome {
        Ok(deviation) => format!("{:>12.2e}  {deviation:>9.1e}  {:>9.1e}{end}\n", reading.value, reading.bound),
        Err(error) => format!("{:>12.2e}  {:>9}  {:>9.1e}  {error}\n", reading.value, "-", reading.bound),
    }
}
