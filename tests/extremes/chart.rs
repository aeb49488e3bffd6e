//! Charts of stress families.

use penumbra::Error;
use penumbra::internal::report::plot;
use penumbra::internal::stress::{Reading, breakdown, placement::SCALE};

/// A chart has a line for every series, and no values that a logarithmic axis cannot show.
#[test]
fn charts_have_a_line_for_every_series() {
    let reading = |value, outcome| Reading { value, bound: 1e-3, outcome };
    let readings = || {
        vec![
            reading(1.0, Ok(0.0)),
            reading(10.0, Ok(1e-4)),
            reading(100.0, Ok(f64::INFINITY)),
            reading(1000.0, Err(Error::Usage("no".into()))),
        ]
    };
    assert_eq!(breakdown(&readings()), Some(100.0));
    assert_eq!(breakdown(&readings()[..2]), None);
    let curves: Vec<_> = SCALE.series.iter().map(|series| (series, readings())).collect();
    let chart = plot::stress(&SCALE, &curves).unwrap();
    assert!(SCALE.series.iter().all(|series| chart.contains(series.name)), "{chart}");
    assert!(!chart.contains("NaN") && !chart.contains("inf"), "{chart}");
}
