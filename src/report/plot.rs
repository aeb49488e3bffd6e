//! The plots of a report, as SVG.

use std::collections::BTreeMap;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, KeyPointWeight};
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::document::{EntrantReport, Report, SnapshotReport};
use super::format::number;
use super::interval::Interval;
use super::sweep::{Savings, Sweep, SweepPoint};
use crate::settings::{Denoise, Technique};
use crate::stress::{self, Family, Reading};
use crate::{Error, Result};

/// Width and height of a plot in pixels.
const SIZE: (u32, u32) = (760, 460);

/// Height in pixels of a bar with its margin, and of the legend and axis below the bars.
const BAR: u32 = 44;
const BELOW_BARS: u32 = 96;

/// One colour for each technique and for `auto`: Okabe and Ito's, which remain distinct for all types of colour vision
/// on dark and light backgrounds, and others between them. Dashes and filled points tell its denoisers apart.
const COLOURS: [RGBColor; 11] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(170, 68, 153),
    RGBColor(153, 153, 51),
    RGBColor(140, 86, 75),
    RGBColor(136, 34, 85),
    RGBColor(92, 92, 214),
];

/// The colour of passes without a legend entry of their own.
const OTHERS: RGBColor = RGBColor(140, 140, 140);

/// Pixels for a letter of a name beside a bar, and minimum pixels for all names.
const LETTER: i32 = 8;
const MIN_NAMES: i32 = 130;

/// Number of parts of a bar with their own colour and legend entry.
const PARTS: usize = 6;

/// Maximum number of labelled marks on an axis.
const MAX_MARKS: usize = 10;

/// Margin around the data on a logarithmic axis, as a factor.
const MARGIN: f64 = 1.3;

/// relMSE against seconds, with the 95 % interval over the runs as a band and the reference's own error as a line.
///
/// # Errors
/// [`Error::Output`] if drawing fails.
pub fn error_over_time(report: &Report) -> Result<String> {
    let curves: Vec<_> = report
        .entrants
        .iter()
        .map(|entrant| {
            let slope = entrant.slope.map_or(String::new(), |slope| format!(", slope {:.2}", slope.value));
            Series::new(entrant, slope, |snapshot| snapshot.time.value)
        })
        .collect();
    draw("error.svg", SIZE, |area| logarithmic(area, &curves, ["seconds", "relMSE"], Some(-1.0), floor(report)))
}

/// relMSE against the rays that determine visibility: shadow rays, audits, photons and rays of cells. `path` is left
/// out, because its rays do both.
///
/// # Errors
/// As [`error_over_time`].
pub fn error_over_rays(report: &Report) -> Result<String> {
    let rays = |snapshot: &SnapshotReport| {
        let rays = snapshot.rays;
        (rays.shadow + rays.audit + rays.photon + rays.cell) as f64
    };
    let own = |entrant: &&EntrantReport| entrant.settings.technique != Technique::PATH;
    let entrants = report.entrants.iter().filter(own);
    let curves: Vec<_> = entrants.map(|entrant| Series::new(entrant, String::new(), rays)).collect();
    draw("rays.svg", SIZE, |area| {
        let names = ["shadow rays, audits, photons and rays of cells", "relMSE"];
        logarithmic(area, &curves, names, None, floor(report))
    })
}

/// The effect of a setting on the visibility map and its error, with the power law that the boundary share follows at
/// hard edges.
///
/// # Errors
/// As [`error_over_time`].
pub fn sweep(sweep: &Sweep) -> Result<String> {
    let series = |name: &str, colour: RGBColor, quantity: &dyn Fn(&SweepPoint) -> Interval| {
        let points = sweep.points.iter().map(|point| (f64::from(point.value), quantity(point)));
        // 0 cannot be drawn on a logarithmic axis.
        let points = points.filter(|(_, y)| y.value > 0.0).collect();
        Series { name: name.to_owned(), colour, dash: None, points, dashed: Vec::new() }
    };
    let series = [
        series("boundary share", COLOURS[0], &|point| exact(point.boundary_share)),
        series("fill", COLOURS[1], &|point| point.fill),
        series("miss", COLOURS[2], &|point| point.miss),
        series("relMSE", COLOURS[3], &|point| exact(point.fine_cells.relmse)),
    ];
    let (setting, law) = (sweep.setting.name(), sweep.setting.law());
    draw(&format!("sweep-{setting}.svg"), SIZE, |area| logarithmic(area, &series, [setting, ""], Some(law), None))
}

/// How many rays and how much time a setting saves, and at what accuracy: with fine cells, and by photons alone.
///
/// # Errors
/// As [`error_over_time`].
pub fn savings(sweep: &Sweep) -> Result<String> {
    let series = |name: &str, colour: RGBColor, quantity: &dyn Fn(&Savings) -> f64| {
        let values = |of: &dyn Fn(&SweepPoint) -> Savings| -> Vec<(f64, f64)> {
            let points = sweep.points.iter().map(|point| (f64::from(point.value), quantity(&of(point))));
            // 0 cannot be drawn on a logarithmic axis.
            points.filter(|(_, y)| *y > 0.0).collect()
        };
        Series {
            name: name.to_owned(),
            colour,
            dash: None,
            points: values(&|point| point.fine_cells).into_iter().map(|(x, y)| (x, exact(y))).collect(),
            dashed: values(&|point| point.photons_alone),
        }
    };
    let series = [
        series("time over two-pass", COLOURS[0], &|savings| savings.time),
        series("all rays over two-pass", COLOURS[1], &|savings| savings.rays),
        series("1 - reduction", COLOURS[2], &|savings| 1.0 - savings.reduction),
        series("fill seen", COLOURS[3], &|savings| savings.fill_seen),
        // Often no audit finds a miss, and 0 cannot be drawn.
        series("upper bound of miss bias", COLOURS[4], &|savings| savings.miss_bias.high),
    ];
    let setting = sweep.setting.name();
    let names = [setting, "solid: with fine cells; dashed: photons alone"];
    draw(&format!("savings-{setting}.svg"), SIZE, |area| logarithmic(area, &series, names, None, None))
}

/// Render times over that of `two-pass`, by the names of the techniques, against the price of a shadow ray in
/// microseconds, with a line where they are equal.
///
/// # Errors
/// As [`error_over_time`].
pub fn break_even(prices: &[f64], ratios: &[(&str, Vec<f64>)]) -> Result<String> {
    let series = ratios.iter().zip(COLOURS).map(|((name, ratios), colour)| Series {
        name: (*name).to_owned(),
        colour,
        dash: None,
        points: prices.iter().zip(ratios).map(|(price, ratio)| (*price, exact(*ratio))).collect(),
        dashed: Vec::new(),
    });
    let series: Vec<_> = series.collect();
    let names = ["microseconds a shadow ray", "time over two-pass"];
    draw("break-even.svg", SIZE, |area| logarithmic(area, &series, names, None, Some(("two-pass", 1.0))))
}

/// Smaller deviations, 0 among them, are drawn at this value, because the axis is logarithmic.
const MIN_DEVIATION: f64 = 1e-9;

/// A family's deviations over its parameter, with their bounds as dashed lines. Renders that failed are left out.
///
/// # Errors
/// As [`error_over_time`].
pub fn stress(family: &Family, curves: &[(&stress::Series, Vec<Reading>)]) -> Result<String> {
    let series = COLOURS.into_iter().cycle().zip(curves).map(|(colour, (series, readings))| {
        let drawn = |deviation: f64| deviation.max(MIN_DEVIATION);
        let finite = |reading: &Reading| {
            let deviation = *reading.outcome.as_ref().ok()?;
            deviation.is_finite().then(|| (reading.value, exact(drawn(deviation))))
        };
        Series {
            name: series.name.to_owned(),
            colour,
            dash: None,
            points: readings.iter().filter_map(finite).collect(),
            dashed: readings.iter().map(|reading| (reading.value, drawn(reading.bound))).collect(),
        }
    });
    let series: Vec<_> = series.collect();
    let deviation = format!("deviation (0 at {MIN_DEVIATION:.0e})");
    draw(&format!("{}.svg", family.name), SIZE, |area| {
        logarithmic(area, &series, [family.parameter, &deviation], None, None)
    })
}

/// A value without uncertainty.
fn exact(value: f64) -> Interval {
    Interval { value, low: value, high: value }
}

/// The time of each entrant by pass, until its last snapshot, as stacked bars.
///
/// # Errors
/// As [`error_over_time`].
pub fn time_by_pass(report: &Report) -> Result<String> {
    let bars: Vec<Bar> = report.entrants.iter().map(Bar::new).collect();
    let legend = Legend::new(&bars);
    let height = BAR * bars.len() as u32 + BELOW_BARS;
    draw("passes.svg", (SIZE.0, height), |area| draw_bars(area, &bars, &legend, height))
}

/// The time of an entrant and its parts.
struct Bar {
    entrant: String,
    /// Names and seconds.
    parts: Vec<(String, f64)>,
}

/// The parts with their own colour, the longest first, and one entry for all others if there are any.
struct Legend<'a> {
    names: Vec<&'a str>,
    own: usize,
}

impl<'a> Legend<'a> {
    fn new(bars: &'a [Bar]) -> Legend<'a> {
        let mut totals: BTreeMap<&str, f64> = BTreeMap::new();
        for (name, seconds) in bars.iter().flat_map(|bar| &bar.parts) {
            *totals.entry(name).or_default() += seconds;
        }
        let mut totals: Vec<(&str, f64)> = totals.into_iter().collect();
        totals.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut names: Vec<&str> = totals.into_iter().map(|(name, _)| name).collect();
        let own = names.len().min(PARTS);
        let others = names.split_off(own);
        if !others.is_empty() {
            names.push("other passes");
        }
        Legend { names, own }
    }

    /// The index of a part among the entries. All parts without an entry of their own have the last one.
    fn place(&self, name: &str) -> usize {
        self.names[..self.own].iter().position(|own| *own == name).unwrap_or(self.own)
    }

    /// A part's colour.
    fn colour(&self, name: &str) -> RGBColor {
        COLOURS[..self.own].get(self.place(name)).copied().unwrap_or(OTHERS)
    }
}

fn draw_bars(area: &Area<'_>, bars: &[Bar], legend: &Legend<'_>, height: u32) -> Drawn {
    let count = bars.len();
    let longest = bars.iter().map(|bar| bar.parts.iter().map(|part| part.1).sum()).fold(0.0, f64::max);
    let letters = bars.iter().map(|bar| bar.entrant.len()).max().unwrap_or(0);
    let names = (LETTER * letters as i32).max(MIN_NAMES);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(names)
        // The range below 0 makes room for the legend.
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
    for (index, Bar { entrant, parts }) in bars.iter().enumerate() {
        let row = (count - 1 - index) as f64;
        let mut from = 0.0;
        let mut parts: Vec<_> = parts.iter().collect();
        parts.sort_by_key(|(name, _)| legend.place(name));
        for (name, seconds) in parts {
            let corners = [(from, row + 0.2), (from + seconds, row + 0.8)];
            chart.draw_series([Rectangle::new(corners, legend.colour(name).filled())])?;
            from += seconds;
        }
        let (x, y) = chart.backend_coord(&(0.0, row + 0.5));
        area.draw_text(entrant, &text_style().into_text_style(area), (x - names + 5, y - 8))?;
    }
    for (index, name) in legend.names.iter().enumerate() {
        let (x, y) = (150 + 85 * index as i32, height as i32 - 75);
        area.draw(&Rectangle::new([(x, y), (x + 10, y + 10)], legend.colour(name).filled()))?;
        area.draw_text(name, &text_style().into_text_style(area), (x + 14, y - 2))?;
    }
    Ok(())
}

impl Bar {
    /// Splits an entrant's time into compilation, passes by kernel, denoiser, and the rest, which is the host's.
    fn new(entrant: &EntrantReport) -> Bar {
        let mut parts: BTreeMap<String, f64> = BTreeMap::new();
        for (pass, seconds) in &entrant.time.passes {
            let kernel = pass.split('/').next().unwrap_or(pass);
            *parts.entry(kernel.to_owned()).or_default() += seconds;
        }
        let passes: f64 = parts.values().sum();
        let whole = entrant.snapshots.last().map_or(0.0, |snapshot| snapshot.time.value);
        let (compile, denoise) = (entrant.time.compile, entrant.time.denoise);
        parts.insert("compilation".to_owned(), compile);
        parts.insert("host".to_owned(), (whole - passes - compile - denoise).max(0.0));
        if denoise > 0.0 {
            parts.insert("denoiser".to_owned(), denoise);
        }
        Bar { entrant: entrant.entrant.to_string(), parts: parts.into_iter().collect() }
    }
}

/// One line of a plot.
struct Series {
    name: String,
    colour: RGBColor,
    /// Pixels of its dashes and of the gaps between them; `None` for a continuous line.
    dash: Option<[i32; 2]>,
    /// x, and y with its interval, drawn as a band.
    points: Vec<(f64, Interval)>,
    /// Other values of y, drawn dashed; may be empty.
    dashed: Vec<(f64, f64)>,
}

impl Series {
    fn new(entrant: &EntrantReport, suffix: String, x: impl Fn(&SnapshotReport) -> f64) -> Series {
        let of = entrant.entrant;
        let mut coloured = Technique::all().map(Some).chain([None]).zip(COLOURS);
        Series {
            name: format!("{of}{suffix}"),
            colour: coloured.find(|(technique, _)| *technique == of.technique).map_or(OTHERS, |(_, colour)| colour),
            dash: match of.denoise {
                Denoise::None => None,
                Denoise::Statistical => Some([8, 4]),
                Denoise::Oidn => Some([2, 3]),
                Denoise::Auto => Some([12, 3]),
            },
            points: entrant.snapshots.iter().map(|snapshot| (x(snapshot), snapshot.relmse)).collect(),
            dashed: Vec::new(),
        }
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// Draws on a white background and returns the SVG.
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

/// Names of the axes.
type AxisNames<'a> = [&'a str; 2];

/// A constant for comparison: its name and its value.
type Level = (&'static str, f64);

/// The error of the reference itself, if it is known and not 0.
fn floor(report: &Report) -> Option<Level> {
    report.reference.relmse.filter(|relmse| *relmse > 0.0).map(|relmse| ("reference's own error", relmse))
}

/// A plot of positive numbers on logarithmic axes, with an optional power law and an optional level for comparison.
fn logarithmic(
    area: &Area<'_>,
    series: &[Series],
    [x_name, y_name]: AxisNames<'_>,
    power: Option<f64>,
    level: Option<Level>,
) -> Drawn {
    if series.iter().all(|series| series.points.is_empty()) {
        let middle = (i32::try_from(SIZE.0 / 2)? - 80, i32::try_from(SIZE.1 / 2)?);
        return Ok(area.draw_text("there is nothing to show", &text_style().into_text_style(area), middle)?);
    }
    let [x, y] = ranges(series, level);
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
    if let Some(level) = level {
        draw_level(&mut chart, level)?;
    }
    if let Some((power, (from, error))) = power.zip(series.first().and_then(|series| series.points.first())) {
        draw_power_law(&mut chart, power, (*from, error.value))?;
    }
    for series in series {
        draw_line(&mut chart, series)?;
    }
    let values = |points: &[(f64, Interval)]| points.iter().map(|(x, y)| (*x, y.value)).collect::<Vec<_>>();
    let mut lines: Vec<_> = series.iter().map(|series| values(&series.points)).collect();
    lines.extend(level.map(|(_, level)| vec![(x.start, level), (x.end, level)]));
    let entries = series
        .iter()
        .map(|series| series.name.as_str())
        .chain(level.map(|level| level.0))
        .chain(power.map(|_| "power"));
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

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Logarithmic, Logarithmic>>;

/// The ranges of both axes over all values and intervals, those of dashed lines included. Of an interval, at most a
/// factor of 2 below its value counts.
fn ranges(series: &[Series], level: Option<Level>) -> [Range<f64>; 2] {
    let points = || series.iter().flat_map(|series| &series.points);
    let dashed = series.iter().flat_map(|series| &series.dashed).map(|(_, y)| *y);
    let y = points().flat_map(|(_, y)| [y.value, y.low.max(y.value / 2.0), y.high]);
    [axis(points().map(|(x, _)| *x)), axis(y.chain(level.map(|level| level.1)).chain(dashed))]
}

fn draw_level(chart: &mut Chart<'_, '_>, (name, level): Level) -> Drawn {
    let x = chart.x_range();
    let line = [(x.start, level), (x.end, level)];
    chart
        .draw_series(DashedLineSeries::new(line, 6, 4, BLACK.stroke_width(1)))?
        .label(name)
        .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], BLACK));
    Ok(())
}

/// A power law through a point, as far as the plot goes.
fn draw_power_law(chart: &mut Chart<'_, '_>, power: f64, (from, value): (f64, f64)) -> Drawn {
    let (x, y) = (chart.x_range(), chart.y_range());
    let edge = if power < 0.0 { y.start } else { y.end };
    let to = x.end.min(from * (edge / value).powf(1.0 / power));
    let line = [(from, value), (to, value * (to / from).powf(power))];
    chart
        .draw_series(DashedLineSeries::new(line, 2, 4, BLACK.mix(0.6).stroke_width(1)))?
        .label(format!("power {power}"))
        .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], BLACK.mix(0.6)));
    Ok(())
}

fn draw_line(chart: &mut Chart<'_, '_>, Series { name, colour, dash, points, dashed }: &Series) -> Drawn {
    let dashes = DashedLineSeries::new(dashed.iter().copied(), 6, 4, colour.mix(0.6).stroke_width(1));
    chart.draw_series(dashes)?;
    let y = chart.y_range();
    let inside = |value: f64| value.clamp(y.start, y.end);
    let upper = points.iter().map(|(x, y)| (*x, inside(y.high)));
    let lower = points.iter().rev().map(|(x, y)| (*x, inside(y.low)));
    chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.2).filled())])?;
    let line: Vec<(f64, f64)> = points.iter().map(|(x, y)| (*x, y.value)).collect();
    let style = colour.stroke_width(2);
    match *dash {
        None => chart
            .draw_series(LineSeries::new(line, style).point_size(3))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], style)),
        Some([dash, gap]) => {
            chart.draw_series(line.iter().map(|point| Circle::new(*point, 3, style.filled())))?;
            chart
                .draw_series(DashedLineSeries::new(line, dash, gap, style))?
                .label(name)
                .legend(move |(x, y)| DashedPathElement::new([(x, y), (x + 16, y)], dash, gap, style))
        }
    };
    Ok(())
}

/// The corner in which a legend of these entries hides the smallest part of the lines, whose points are fractions of
/// the axes.
fn corner<'a>(
    entries: impl Iterator<Item = &'a str>,
    lines: impl Iterator<Item = Vec<[f64; 2]>>,
) -> SeriesLabelPosition {
    let (mut longest, mut count) = (0, 0);
    for entry in entries {
        (longest, count) = (longest.max(entry.len()), count + 1);
    }
    // The layout of plotters: half the text size per letter, the full size per line, and a margin.
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

/// A logarithmic axis with marks at 1, 2 and 5 times the powers of ten, or at the powers only if those are too many.
/// The axis of plotters lacks marks below its first power of ten and repeats others.
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
        let bold = [marks(&[1.0, 2.0, 5.0], 1), marks(&[1.0], 1)].into_iter().find(|marks| marks.len() <= MAX_MARKS);
        match hint.weight() {
            KeyPointWeight::Bold => {
                bold.unwrap_or_else(|| marks(&[1.0], ((last - first) as usize).div_ceil(MAX_MARKS)))
            }
            KeyPointWeight::Any if (last - first) as usize <= MAX_MARKS => marks(&DIGITS, 1),
            // Denser lines would merge into an area.
            KeyPointWeight::Any => Vec::new(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.0.clone()
    }
}

/// The position of a value on a logarithmic axis: 0 at its start, 1 at its end.
fn share(axis: &Range<f64>, value: f64) -> f64 {
    (value / axis.start).ln() / (axis.end / axis.start).ln()
}

/// The range of the values, with a margin.
fn axis(values: impl Iterator<Item = f64>) -> Range<f64> {
    let usable = values.filter(|x| x.is_finite() && *x > 0.0);
    let (low, high) = usable.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
    // An arbitrary range if there are no values.
    if low <= high { low / MARGIN..high * MARGIN } else { 0.1..10.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each technique has a curve of its own colour, and so has `auto`.
    #[test]
    fn no_two_techniques_share_a_colour() {
        assert!(Technique::all().len() < COLOURS.len(), "a technique without a colour");
        let distinct: std::collections::BTreeSet<_> =
            COLOURS.iter().chain([&OTHERS]).map(|c| (c.0, c.1, c.2)).collect();
        assert_eq!(distinct.len(), COLOURS.len() + 1);
    }
}
