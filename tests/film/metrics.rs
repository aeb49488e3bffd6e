//! Metrics against values computed by hand and by the authors' own tools.

use penumbra::internal::render::film::Image;
use penumbra::internal::report::metrics::{flip, mae, p99, relmse, rmse};

/// An image whose pixels are `colour(x, y)`.
fn image(width: u32, height: u32, colour: impl Fn(u32, u32) -> [f32; 3]) -> Image {
    let mut image = Image::new(width, height);
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let samples = (0..width * height).map(|i| colour(i % width, i / width)[c]).collect();
        image.add_channel(name, samples);
    }
    image
}

#[test]
fn measures_follow_their_formulas() {
    let x = image(2, 1, |x, _| if x == 0 { [1.0, 2.0, 0.0] } else { [3.0, 0.5, 0.25] });
    let r = image(2, 1, |x, _| if x == 0 { [0.0, 2.0, 1.0] } else { [1.0, 0.5, 0.25] });
    // Differences 1, 0, -1, 2, 0, 0.
    assert_eq!(mae(&x, &r).unwrap(), 4.0 / 6.0);
    assert_eq!(rmse(&x, &r).unwrap(), 1.0);
    let expected = (1.0 / 0.01 + 1.0 / 1.01 + 4.0 / 1.01) / 6.0;
    // Rounding of six terms in f64.
    assert!((relmse(&x, &r).unwrap() - expected).abs() < 1e-13);
}

#[test]
fn the_percentile_is_the_minimum_that_99_of_100_do_not_exceed() {
    // Differences of 1 to 300, each once: 297 of them are at most 297.
    let x = image(10, 10, |x, y| [0, 1, 2].map(|c| ((x + 10 * y) * 3 + c + 1) as f32));
    assert_eq!(p99(&x, &image(10, 10, |_, _| [0.0; 3])).unwrap(), 297.0);
    let one = image(1, 1, |_, _| [1.0, 2.0, 7.0]);
    assert_eq!(p99(&one, &image(1, 1, |_, _| [0.0; 3])).unwrap(), 7.0);
}

#[test]
fn large_images_lose_no_digits() {
    // All squares are equal, so the mean is that number for any number of pixels.
    let x = image(2048, 2048, |_, _| [0.1; 3]);
    let r = image(2048, 2048, |_, _| [0.0; 3]);
    let expected = f64::from(0.1f32);
    // 12 million terms summed in rows of 4096: at most 4096 + 3072 roundings of f64 of either sign.
    assert!((rmse(&x, &r).unwrap() / expected - 1.0).abs() < 7168.0 * f64::EPSILON);
}

/// The scene-linear colour that the neutral view maps to these sRGB codes, which must be at most 225. There the view
/// does not compress and is easy to invert (out = x - offset, and 6.25 x^2 for a minimum component below 0.08).
fn shown_as(codes: [u32; 3]) -> [f32; 3] {
    let linear = codes.map(|code| {
        let x = f64::from(code) / 255.0;
        if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    });
    let darkest = linear[0].min(linear[1]).min(linear[2]);
    let offset = if darkest < 0.04 { (darkest / 6.25).sqrt() - darkest } else { 0.04 };
    linear.map(|x| (x + offset) as f32)
}

/// The expected values are means of `flip.evaluate(reference, test, "LDR")` of flip-evaluator 1.7, by the authors of
/// FLIP, for the same sRGB images of 48 x 32 pixels.
#[test]
fn flip_agrees_with_its_authors() {
    let check = |reference: &Image, test: &Image, expected: f64| {
        let found = flip(test, reference).unwrap();
        // The authors' versions differ in the order of f32 sums over 1536 pixels and in the rounding of filters.
        assert!((found - expected).abs() < 2e-4, "{found} for {expected}");
    };
    let black = image(48, 32, |_, _| [0.0; 3]);
    let white = image(48, 32, |_, _| [1e9; 3]);
    check(&black, &white, 0.967_399);

    let checker = image(48, 32, |x, y| shown_as([if (x / 4 + y / 4) % 2 == 1 { 200 } else { 60 }; 3]));
    let grey = image(48, 32, |_, _| shown_as([130; 3]));
    check(&checker, &grey, 0.357_652);

    let ramp = image(48, 32, |x, y| shown_as([x * 4, y * 7, (x + y) * 2]));
    let mirrored = image(48, 32, |x, y| shown_as([(47 - x) * 4, y * 7, (x + y) * 2]));
    check(&ramp, &mirrored, 0.533664);
    check(&mirrored, &ramp, 0.533664);
}

#[test]
fn the_error_of_an_image_against_itself_is_zero() {
    let x = image(40, 30, |x, y| [x as f32, y as f32 * 0.01, 1e8]);
    for metric in [rmse, relmse, mae, p99, flip] {
        assert_eq!(metric(&x, &x).unwrap(), 0.0);
    }
}

#[test]
fn errors_of_incomparable_images_name_the_cause() {
    let good = image(3, 2, |_, _| [1.0; 3]);
    let other = image(2, 3, |_, _| [1.0; 3]);
    let mut grey = Image::new(3, 2);
    grey.add_channel("R", vec![1.0; 6]);
    let mut broken = good.clone();
    broken.channels[1].samples[4] = f32::NAN;
    let empty = image(0, 0, |_, _| [0.0; 3]);

    for metric in [rmse, relmse, mae, p99, flip] {
        let error = |x: &Image, r: &Image| metric(x, r).unwrap_err().to_string();
        assert_eq!(error(&good, &other), "image: its size is 3 x 2 pixels, that of the reference 2 x 3");
        assert_eq!(error(&good, &grey), "reference: G: there is no such channel");
        assert_eq!(error(&grey, &good), "image: G: there is no such channel");
        assert_eq!(error(&broken, &good), "image: G: pixel (1, 1) is NaN");
        assert_eq!(error(&good, &broken), "reference: G: pixel (1, 1) is NaN");
        assert_eq!(error(&empty, &empty), "image: it has no pixels");
    }
}
