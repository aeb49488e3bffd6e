//! The plots of a report, as SVG.

use std::collections::BTreeMap;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, KeyPointWeight};
use plotters::prelude::*;

use crate::settings::Technique;
use crate::stress::{self, Family, Reading};
use crate::{Error, Result};

use super::document::{Report, SnapshotReport, TechniqueReport};
use super::interval::Interval;
use super::sweep::{Sweep, SweepPoint};

/// Pixels.
const SIZE: (u32, u32) = (760, 460);

/// Pixels of a bar with the room around it, and of what is below all bars.
const BAR: u32 = 44;
const BELOW_BARS: u32 = 96;

/// Okabe and Ito's colours, which people with any colour vision tell apart on dark and on light.
/// Two of Tol's come with them, as there are nine techniques.
const COLOURS: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(170, 68, 153),
    RGBColor(153, 153, 51),
    RGBColor(140, 140, 140),
];

/// Parts of a bar that have a colour each, and room in the legend.
const PARTS: usize = 6;

/// Most marks of an axis.
const MARKS: usize = 10;

/// Room around the data of a logarithmic axis, as a factor.
const MARGIN: f64 = 1.3;

/// relMSE against seconds, with a band over the runs, and the reference's own error as the floor.
///
/// # Errors
/// [`Error::Output`] where the drawing fails.
pub fn error_over_time(report: &Report) -> Result<String> {
    let curves: Vec<_> = report
        .techniques
        .iter()
        .map(|technique| {
            let slope = technique.slope.map_or(String::new(), |slope| format!(", slope {:.2}", slope.value));
            Series::new(technique, slope, |snapshot| snapshot.time.value)
        })
        .collect();
    draw("error.svg", SIZE, |area| {
        logarithmic(area, &curves, ["seconds", "relMSE"], Some(-1.0), report.reference.relmse)
    })
}

/// relMSE against the rays that ask for visibility: shadow rays, audits, photons and rays of cells. `path` has none of its own.
///
/// # Errors
/// As [`error_over_time`].
pub fn error_over_rays(report: &Report) -> Result<String> {
    let rays = |snapshot: &SnapshotReport| {
        let rays = snapshot.rays;
        (rays.shadow + rays.audit + rays.photon + rays.cell) as f64
    };
    let own = |technique: &&TechniqueReport| technique.settings.technique != Technique::PATH;
    let techniques = report.techniques.iter().filter(own);
    let curves: Vec<_> = techniques.map(|technique| Series::new(technique, String::new(), rays)).collect();
    draw("rays.svg", SIZE, |area| {
        let names = ["shadow rays, audits, photons and rays of cells", "relMSE"];
        logarithmic(area, &curves, names, None, report.reference.relmse)
    })
}

/// What a setting of the visibility map does, over the law that boundaries follow at hard edges.
///
/// # Errors
/// As [`error_over_time`].
pub fn sweep(sweep: &Sweep) -> Result<String> {
    let series = |name: &str, colour: RGBColor, quantity: &dyn Fn(&SweepPoint) -> Interval| {
        let points = sweep.points.iter().map(|point| (f64::from(point.value), quantity(point)));
        // Nothing has no place on a logarithmic axis.
        let points = points.filter(|(_, y)| y.value > 0.0).collect();
        Series { name: name.to_owned(), colour, points, bound: Vec::new() }
    };
    let series = [
        series("boundary share", COLOURS[0], &|point| exact(point.boundary_share)),
        series("fill", COLOURS[1], &|point| point.fill),
        series("miss", COLOURS[2], &|point| point.miss),
        series("relMSE", COLOURS[3], &|point| exact(point.relmse)),
    ];
    let (setting, law) = (sweep.setting.name(), sweep.setting.law());
    draw(&format!("sweep-{setting}.svg"), SIZE, |area| logarithmic(area, &series, [setting, ""], Some(law), None))
}

/// Deviations at or below this are drawn there, as 0 has no place on a logarithmic axis.
const LEAST_DEVIATION: f64 = 1e-9;

/// What a family's deviations do along its parameter, with their bounds dashed. Renders that ended with an error are left out.
///
/// # Errors
/// As [`error_over_time`].
pub fn stress(family: &Family, curves: &[(&stress::Series, Vec<Reading>)]) -> Result<String> {
    let series = COLOURS.into_iter().cycle().zip(curves).map(|(colour, (series, readings))| {
        let place = |deviation: f64| deviation.max(LEAST_DEVIATION);
        let finite = |reading: &Reading| {
            let deviation = *reading.outcome.as_ref().ok()?;
            deviation.is_finite().then(|| (reading.value, exact(place(deviation))))
        };
        Series {
            name: series.name.to_owned(),
            colour,
            points: readings.iter().filter_map(finite).collect(),
            bound: readings.iter().map(|reading| (reading.value, place(reading.bound))).collect(),
        }
    });
    let series: Vec<_> = series.collect();
    let deviation = format!("deviation (0 at {LEAST_DEVIATION:.0e})");
    draw(&format!("{}.svg", family.name), SIZE, |area| {
        logarithmic(area, &series, [family.parameter, &deviation], None, None)
    })
}

/// A number without a band.
fn exact(value: f64) -> Interval {
    Interval { value, low: value, high: value }
}

/// Where the time of each technique goes, until its last snapshot.
///
/// # Errors
/// As [`error_over_time`].
pub fn time_by_pass(report: &Report) -> Result<String> {
    let bars: Vec<(String, Vec<(String, f64)>)> = report.techniques.iter().map(bar).collect();
    // The longest parts have a colour each, the rest the last one's.
    let mut totals: BTreeMap<&str, f64> = BTreeMap::new();
    for (name, seconds) in bars.iter().flat_map(|(_, parts)| parts) {
        *totals.entry(name).or_default() += seconds;
    }
    let mut names: Vec<(&str, f64)> = totals.into_iter().collect();
    names.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut names: Vec<&str> = names.into_iter().map(|(name, _)| name).collect();
    let kept = names.len().min(PARTS);
    let others = names.split_off(kept);
    if !others.is_empty() {
        names.push("other passes");
    }
    let own = |name: &str| names[..kept].iter().position(|n| *n == name);
    let colour = |name: &str| own(name).unwrap_or(COLOURS.len() - 1);
    let longest = bars.iter().map(|(_, parts)| parts.iter().map(|part| part.1).sum()).fold(0.0, f64::max);

    let count = bars.len();
    let height = BAR * count as u32 + BELOW_BARS;
    draw("passes.svg", (SIZE.0, height), |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(130)
            // Room for the legend below the bars.
            .build_cartesian_2d(0.0..longest.max(f64::MIN_POSITIVE) * 1.02, -0.7..count as f64)?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .y_labels(0)
            .x_desc("seconds")
            .label_style(text_style())
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.15))
            .draw()?;
        for (index, (technique, parts)) in bars.iter().enumerate() {
            let row = (count - 1 - index) as f64;
            let mut from = 0.0;
            let mut parts: Vec<_> = parts.iter().map(|(name, seconds)| (colour(name), *seconds)).collect();
            parts.sort_by_key(|part| part.0);
            for (colour, seconds) in parts {
                let corners = [(from, row + 0.2), (from + seconds, row + 0.8)];
                chart.draw_series([Rectangle::new(corners, COLOURS[colour].filled())])?;
                from += seconds;
            }
            let (x, y) = chart.backend_coord(&(0.0, row + 0.5));
            area.draw_text(technique, &text_style().into_text_style(area), (x - 125, y - 8))?;
        }
        for (index, name) in names.iter().enumerate() {
            let (x, y) = (150 + 85 * index as i32, height as i32 - 75);
            area.draw(&Rectangle::new([(x, y), (x + 10, y + 10)], COLOURS[colour(name)].filled()))?;
            area.draw_text(name, &text_style().into_text_style(area), (x + 14, y - 2))?;
        }
        Ok(())
    })
}

/// The parts of a technique's time: set-up, passes by kernel, and what the host spends beside them.
fn bar(technique: &TechniqueReport) -> (String, Vec<(String, f64)>) {
    let mut parts: BTreeMap<String, f64> = BTreeMap::new();
    for (pass, seconds) in &technique.time.passes {
        let kernel = pass.split('/').next().unwrap_or(pass);
        *parts.entry(kernel.to_owned()).or_default() += seconds;
    }
    let passes: f64 = parts.values().sum();
    let whole = technique.snapshots.last().map_or(0.0, |snapshot| snapshot.time.value);
    let compile = technique.time.compile;
    parts.insert("compilation".to_owned(), compile);
    parts.insert("host".to_owned(), (whole - passes - compile).max(0.0));
    (technique.settings.technique.to_string(), parts.into_iter().collect())
}

/// One line of a plot.
struct Series {
    name: String,
    colour: RGBColor,
    /// x, and y with its band.
    points: Vec<(f64, Interval)>,
    /// What y is to stay below, if anything: dashed.
    bound: Vec<(f64, f64)>,
}

impl Series {
    fn new(technique: &TechniqueReport, suffix: String, x: impl Fn(&SnapshotReport) -> f64) -> Series {
        let of = technique.settings.technique;
        let index = Technique::all().position(|technique| technique == of).unwrap_or(0);
        Series {
            name: format!("{of}{suffix}"),
            colour: COLOURS[index % COLOURS.len()],
            points: technique.snapshots.iter().map(|snapshot| (x(snapshot), snapshot.relmse)).collect(),
            bound: Vec::new(),
        }
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// A drawing on white.
fn draw(file: &str, size: (u32, u32), content: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
    let drawn = || -> Drawn {
        area.fill(&WHITE)?;
        content(&area)?;
        Ok(area.present()?)
    };
    drawn().map_err(|problem| Error::output(file, problem))?;
    drop(area);
    Ok(text)
}

fn text_style() -> (&'static str, i32) {
    ("sans-serif", 13)
}

/// A plot of positive numbers on logarithmic axes, with a power law and a floor to compare with.
fn logarithmic(
    area: &Area<'_>,
    series: &[Series],
    [x_name, y_name]: [&str; 2],
    power: Option<f64>,
    floor: Option<f64>,
) -> Drawn {
    if series.iter().all(|series| series.points.is_empty()) {
        let place = (i32::try_from(SIZE.0 / 2)? - 80, i32::try_from(SIZE.1 / 2)?);
        return Ok(area.draw_text("there is nothing to show", &text_style().into_text_style(area), place)?);
    }
    let floor = floor.filter(|floor| *floor > 0.0);
    let points = || series.iter().flat_map(|series| &series.points);
    let x = axis(points().map(|(x, _)| *x));
    let bounds = series.iter().flat_map(|series| &series.bound).map(|(_, y)| *y);
    let y = axis(points().flat_map(|(_, y)| [y.value, y.low.max(y.value / 2.0), y.high]).chain(floor).chain(bounds));
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(Logarithmic(x.clone()), Logarithmic(y.clone()))?;
    chart
        .configure_mesh()
        .x_desc(x_name)
        .y_desc(y_name)
        .label_style(text_style())
        .x_label_formatter(&|x| number(*x))
        .y_label_formatter(&|y| number(*y))
        .light_line_style(BLACK.mix(0.05))
        .bold_line_style(BLACK.mix(0.15))
        .draw()?;
    if let Some(floor) = floor {
        let line = [(x.start, floor), (x.end, floor)];
        chart
            .draw_series(DashedLineSeries::new(line, 6, 4, BLACK.stroke_width(1)))?
            .label("reference's own error")
            .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], BLACK));
    }
    if let Some((power, (from, error))) = power.zip(series.first().and_then(|series| series.points.first())) {
        // As far as the plot goes.
        let edge = if power < 0.0 { y.start } else { y.end };
        let to = x.end.min(from * (edge / error.value).powf(1.0 / power));
        let line = [(*from, error.value), (to, error.value * (to / from).powf(power))];
        chart
            .draw_series(DashedLineSeries::new(line, 2, 4, BLACK.mix(0.6).stroke_width(1)))?
            .label(format!("power {power}"))
            .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], BLACK.mix(0.6)));
    }
    for Series { name, colour, points, bound } in series {
        let dashes = DashedLineSeries::new(bound.iter().copied(), 6, 4, colour.mix(0.6).stroke_width(1));
        chart.draw_series(dashes)?;
        let inside = |value: f64| value.clamp(y.start, y.end);
        let upper = points.iter().map(|(x, y)| (*x, inside(y.high)));
        let lower = points.iter().rev().map(|(x, y)| (*x, inside(y.low)));
        chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.2).filled())])?;
        let line = points.iter().map(|(x, y)| (*x, y.value));
        let own = *colour;
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)).point_size(3))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], own.stroke_width(2)));
    }
    let values = |points: &[(f64, Interval)]| points.iter().map(|(x, y)| (*x, y.value)).collect::<Vec<_>>();
    let mut lines: Vec<_> = series.iter().map(|series| values(&series.points)).collect();
    lines.extend(floor.map(|floor| vec![(x.start, floor), (x.end, floor)]));
    let entries = series.iter().map(|series| series.name.as_str()).chain(["reference's own error"; 2]);
    let shares = lines.iter().map(|line| line.iter().map(|point| [share(&x, point.0), share(&y, point.1)]).collect());
    chart
        .configure_series_labels()
        .position(corner(entries, shares))
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font(text_style())
        .draw()?;
    Ok(())
}

/// Where the legend of these entries hides the least of lines whose points are shares of the axes.
fn corner<'a>(
    entries: impl Iterator<Item = &'a str>,
    lines: impl Iterator<Item = Vec<[f64; 2]>>,
) -> SeriesLabelPosition {
    let (mut longest, mut count) = (0, 0);
    for entry in entries {
        (longest, count) = (longest.max(entry.len()), count + 1);
    }
    // As plotters lays it out: half of the text's size a letter and all of it a line, and some room around.
    let size = f64::from(text_style().1);
    let (width, height) = (0.5 * size * longest as f64 + 50.0, 1.3 * size * f64::from(count) + 15.0);
    let (width, height) = (width / f64::from(SIZE.0), height / f64::from(SIZE.1));
    const STEPS: u32 = 32;
    let mut points: Vec<[f64; 2]> = Vec::new();
    for line in lines {
        for (index, from) in line.iter().enumerate() {
            let to = line.get(index + 1).unwrap_or(from);
            let between = |part: u32| [0, 1].map(|i| from[i] + (to[i] - from[i]) * f64::from(part) / f64::from(STEPS));
            points.extend((0..STEPS).map(between));
        }
    }
    let hidden = |left: bool, low: bool| {
        let beside = |x: f64| if left { x < width } else { x > 1.0 - width };
        let above = |y: f64| if low { y < height } else { y > 1.0 - height };
        points.iter().filter(|[x, y]| beside(*x) && above(*y)).count()
    };
    let corners = [
        (SeriesLabelPosition::UpperRight, hidden(false, false)),
        (SeriesLabelPosition::LowerLeft, hidden(true, true)),
        (SeriesLabelPosition::UpperLeft, hidden(true, false)),
        (SeriesLabelPosition::LowerRight, hidden(false, true)),
    ];
    corners.into_iter().min_by_key(|(_, hidden)| *hidden).map_or(SeriesLabelPosition::UpperRight, |(corner, _)| corner)
}

/// A logarithmic axis. Its marks are 1, 2 and 5 times the powers of ten, or powers alone where there would be too many; that of
/// plotters has none below its first power of ten, and some twice.
struct Logarithmic(Range<f64>);

impl Ranged for Logarithmic {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        limit.0 + (f64::from(limit.1 - limit.0) * share(&self.0, *value)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let [first, last] = [self.0.start.log10().floor(), self.0.end.log10().floor()].map(|power| power as i32);
        let marks = |digits: &'static [f64], step: usize| -> Vec<f64> {
            let powers = (first..=last).step_by(step);
            let all = powers.flat_map(|power| digits.iter().map(move |digit| digit * 10f64.powi(power)));
            all.filter(|mark| self.0.contains(mark)).collect()
        };
        const DIGITS: [f64; 9] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];
        let bold = [marks(&[1.0, 2.0, 5.0], 1), marks(&[1.0], 1)].into_iter().find(|marks| marks.len() <= MARKS);
        match hint.weight() {
            KeyPointWeight::Bold => bold.unwrap_or_else(|| marks(&[1.0], ((last - first) as usize).div_ceil(MARKS))),
            KeyPointWeight::Any if (last - first) as usize <= MARKS => marks(&DIGITS, 1),
            // Lines so near to each other would be an area.
            KeyPointWeight::Any => Vec::new(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.0.clone()
    }
}

/// Where a value is on a logarithmic axis: 0 at its start, 1 at its end.
fn share(axis: &Range<f64>, value: f64) -> f64 {
    (value / axis.start).ln() / (axis.end / axis.start).ln()
}

/// From below the least to above the greatest.
fn axis(values: impl Iterator<Item = f64>) -> Range<f64> {
    let usable = values.filter(|x| x.is_finite() && *x > 0.0);
    let (low, high) = usable.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
    // Any axis will do where there is nothing to show.
    if low <= high { low / MARGIN..high * MARGIN } else { 0.1..10.0 }
}

/// As short as can be.
pub(super) fn number(x: f64) -> String {
    if (1e-2..1e4).contains(&x) { format!("{}", (x * 1e6).round() / 1e6) } else { format!("{x:.0e}") }
}
