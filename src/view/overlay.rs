//! What the window shows of an image: the picture, or how the method made it.

use glam::Vec3;

use crate::Image;
use crate::gpu_scene::CameraUniform;
use crate::kernels::{CellKind, Class, ShownCell};
use crate::render::film::View;
use crate::render::photons::{NearestPhotons, VisibilityPhoton};
use crate::scene::Camera;
use crate::settings::Aov;

/// The content of the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// The picture.
    #[default]
    Picture,
    /// The classes of a light's candidates.
    Classes,
    /// The photons of the visibility map, over the picture.
    Photons,
    /// The cells that decide the points for a light, and their classes.
    Cells,
    /// Samples of the pixels.
    Samples,
    /// The estimated standard error of the denoised picture, over its brightness.
    Error,
    /// Base colour.
    Albedo,
    /// Shading normals.
    Normal,
    /// Depth.
    Depth,
}

impl Overlay {
    /// All overlays, in the order of the panel.
    pub const ALL: [Overlay; 9] = [
        Overlay::Picture,
        Overlay::Classes,
        Overlay::Photons,
        Overlay::Cells,
        Overlay::Samples,
        Overlay::Error,
        Overlay::Albedo,
        Overlay::Normal,
        Overlay::Depth,
    ];

    /// Its name in the panel.
    pub fn name(self) -> &'static str {
        match self {
            Overlay::Picture => "picture",
            Overlay::Classes => "classes",
            Overlay::Photons => "photons",
            Overlay::Cells => "cells",
            Overlay::Samples => "samples",
            Overlay::Error => "estimated error",
            Overlay::Albedo => "albedo",
            Overlay::Normal => "normals",
            Overlay::Depth => "depth",
        }
    }

    /// The meaning of its colours.
    pub fn legend(self) -> &'static str {
        match self {
            Overlay::Picture => "",
            Overlay::Classes => "yellow lit, blue shadowed, red boundary, grey unknown, black dark",
            Overlay::Photons => "yellow illumination photons, blue shadow photons",
            Overlay::Cells => {
                "fine cells bright, those of the map dark: yellow lit, blue shadowed, red boundary, grey unknown, \
                 black none"
            }
            Overlay::Samples => "black none, white the maximum of all pixels",
            Overlay::Error => "black 0.1 % of the brightness, red 3 %, white 100 %",
            Overlay::Albedo => "base colour",
            Overlay::Normal => "red +X, green +Y, blue +Z",
            Overlay::Depth => "white near, black far or nothing",
        }
    }

    /// The channels that it shows, if the film must keep more for it.
    pub fn aov(self) -> Option<Aov> {
        match self {
            Overlay::Picture | Overlay::Cells | Overlay::Error => None,
            Overlay::Classes => Some(Aov::Shadow),
            Overlay::Photons | Overlay::Depth => Some(Aov::Depth),
            Overlay::Samples => Some(Aov::Samples),
            Overlay::Albedo => Some(Aov::Albedo),
            Overlay::Normal => Some(Aov::Normal),
        }
    }

    /// Whether it is of a single light.
    pub fn is_of_a_light(self) -> bool {
        matches!(self, Overlay::Classes | Overlay::Photons | Overlay::Cells)
    }

    /// Whether it requires visibility photons. Small pictures have none otherwise.
    pub fn requires_photons(self) -> bool {
        matches!(self, Overlay::Photons | Overlay::Cells)
    }
}

/// How the picture is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Display {
    /// What is shown.
    pub overlay: Overlay,
    /// The light whose classes or photons are shown.
    pub light: usize,
    /// Tone mapping.
    pub view: View,
    /// Exposure in stops.
    pub exposure: f32,
    /// Show the denoised picture where there is one.
    pub denoised: bool,
}

impl Display {
    /// Whether it shows what a denoiser computes.
    pub fn requires_denoising(&self) -> bool {
        match self.overlay {
            Overlay::Picture | Overlay::Photons => self.denoised,
            Overlay::Error => true,
            _ => false,
        }
    }

    /// The denoised picture of `image`, if it is shown.
    pub fn denoised_of(&self, image: &Image) -> Option<Image> {
        image.denoised().filter(|_| self.denoised)
    }
}

/// Colours of the classes, by their codes: dark, lit, shadowed, boundary, unknown.
const CLASS_COLOURS: [[u8; 3]; Class::COUNT] =
    [[0, 0, 0], [240, 200, 40], [40, 80, 200], [220, 40, 40], [128, 128, 128]];

const ILLUMINATION: [u8; 3] = [255, 220, 60];
const SHADOW: [u8; 3] = [70, 130, 255];

/// Share of the picture's brightness behind photons.
const BEHIND_PHOTONS: f32 = 0.4;

/// How much deeper than the pixel's own surface a photon may be and still be shown, as a share of the depth. Photons
/// lie on the surface, whose depth varies across the pixel.
const PHOTON_DEPTH: f64 = 0.02;

/// Relative errors that are shown black and white, as powers of ten.
const ERROR_DECADES: [f32; 2] = [-3.0, 0.0];

/// The darkest of the shades that distinguish cells of a class, and the shade of cell edges and of cells of the map.
const DARKEST_CELL: f32 = 0.7;
const CELL_EDGE: f32 = 0.5;
const MAP_CELL: f32 = 0.6;

/// Maximum number of divisions of cells whose edges are drawn: parts of further divisions are hardly larger than a
/// pixel.
const MAX_EDGED_LEVEL: u32 = 1;

/// Points of the circle that is drawn around the nearest photons. If it is 1,000 pixels wide, its sides are within 0.04
/// pixels of a circle.
const CIRCLE_POINTS: u32 = 256;

const MARK: [u8; 3] = [255, 255, 255];

/// Data that can be shown in an image besides its channels.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// All photons.
    pub photons: &'a [VisibilityPhoton],
    /// The cells of the pixels.
    pub cells: Option<&'a [ShownCell]>,
    /// The photons that decided a point, which are marked.
    pub nearest: Option<&'a NearestPhotons>,
    /// The camera of the image.
    pub camera: &'a Camera,
    /// World lengths to normalised lengths.
    pub scale: f64,
}

/// The pixels to show, as 8-bit RGB, row by row from the top. An image that lacks the channels is shown black.
pub fn pixels(image: &Image, display: &Display, seen: Seen<'_>) -> Vec<u8> {
    let channel = |name: &str| image.channel(name);
    let shown = match display.overlay {
        Overlay::Picture => picture(image, display),
        Overlay::Classes => class_channel(image, display.light).map(|classes| {
            let colour = |class: &f32| CLASS_COLOURS.get(*class as usize).copied().unwrap_or_default();
            classes.iter().flat_map(colour).collect()
        }),
        Overlay::Photons => picture(image, display).map(|mut pixels| {
            pixels.iter_mut().for_each(|x| *x = (f32::from(*x) * BEHIND_PHOTONS) as u8);
            draw_photons(&mut pixels, image, display.light, seen);
            pixels
        }),
        Overlay::Cells => seen.cells.filter(|cells| cells.len() == image.pixels()).map(|cells| {
            let shade = |pixel: usize| cell_colour(cells, pixel, image.width as usize);
            (0..cells.len()).flat_map(shade).collect()
        }),
        Overlay::Samples => channel("samples").map(|samples| {
            let max = samples.iter().copied().fold(1.0, f32::max);
            grey(samples.iter().map(|n| n / max))
        }),
        Overlay::Error => channel("relative_error").map(|errors| {
            let [black, white] = ERROR_DECADES;
            let share = |error: &f32| (error.log10() - black) / (white - black);
            errors.iter().map(share).flat_map(heat).collect()
        }),
        Overlay::Albedo => colour_channels(image, ["albedo.R", "albedo.G", "albedo.B"], |x| x, View::Standard),
        Overlay::Normal => colour_channels(image, ["N.X", "N.Y", "N.Z"], |x| 0.5 * x + 0.5, View::Raw),
        Overlay::Depth => channel("Z").map(|depths| {
            // Where there is nothing, the depth is 1e10.
            let is_there = |z: &f32| *z < 1e9;
            let there = || depths.iter().copied().filter(is_there);
            let (near, far) = (there().fold(f32::INFINITY, f32::min), there().fold(0.0, f32::max));
            let shade = |z: &f32| 1.0 - (z - near) / (far - near).max(f32::MIN_POSITIVE);
            grey(depths.iter().map(|z| if is_there(z) { shade(z) } else { 0.0 }))
        }),
    };
    let mut shown = shown.unwrap_or_else(|| vec![0; image.pixels() * 3]);
    if let Some(nearest) = seen.nearest {
        mark_nearest(&mut shown, image, nearest, seen);
    }
    shown
}

/// The colour of a pixel's cell: a hue by its class, a shade by the cell, and darker where another cell begins.
fn cell_colour(cells: &[ShownCell], pixel: usize, width: usize) -> [u8; 3] {
    let cell = cells[pixel];
    let mut shade = match cell.kind {
        CellKind::None => 0.0,
        CellKind::Fine => 1.0,
        CellKind::Map | CellKind::Requested => MAP_CELL,
    };
    shade *= DARKEST_CELL + (1.0 - DARKEST_CELL) * (cell.hash & 0xff) as f32 / 255.0;
    let right = (pixel % width + 1 < width).then(|| cells[pixel + 1]);
    let differs = |other: ShownCell| (other.kind, other.level, other.hash) != (cell.kind, cell.level, cell.hash);
    if cell.level <= MAX_EDGED_LEVEL && right.into_iter().chain(cells.get(pixel + width).copied()).any(differs) {
        shade *= CELL_EDGE;
    }
    CLASS_COLOURS[cell.class as usize].map(|x| (f32::from(x) * shade) as u8)
}

fn picture(image: &Image, display: &Display) -> Option<Vec<u8>> {
    let denoised = display.denoised_of(image);
    denoised.as_ref().unwrap_or(image).display(display.view, display.exposure).ok()
}

/// The classes of a light, by its index.
fn class_channel(image: &Image, light: usize) -> Option<&[f32]> {
    let classes = image.channels.iter().filter(|channel| is_class(&channel.name));
    classes.map(|channel| channel.samples.as_slice()).nth(light)
}

/// Whether that is the name of a light's classes: `shadow.<light>.class`.
pub fn is_class(name: &str) -> bool {
    name.starts_with("shadow.") && name.ends_with(".class")
}

fn colour_channels(image: &Image, names: [&str; 3], of: impl Fn(f32) -> f32, view: View) -> Option<Vec<u8>> {
    let [r, g, b] = [image.channel(names[0])?, image.channel(names[1])?, image.channel(names[2])?];
    let pixel = |i: usize| view.apply([r[i], g[i], b[i]].map(&of)).map(byte);
    Some((0..image.pixels()).flat_map(pixel).collect())
}

fn byte(x: f32) -> u8 {
    (x * 255.0).round() as u8
}

fn grey(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(|x| [byte(x.clamp(0.0, 1.0)); 3]).collect()
}

/// From black over red to white.
fn heat(x: f32) -> [u8; 3] {
    [2.0 * x, 2.0 * x - 1.0, 3.0 * x - 2.0].map(|c| byte(c.clamp(0.0, 1.0)))
}

/// Where positions are in an image, and whether the camera sees them.
struct Sight<'a> {
    camera: CameraUniform,
    size: [u32; 2],
    depths: Option<&'a [f32]>,
    scale: f64,
}

impl<'a> Sight<'a> {
    fn new(image: &'a Image, seen: Seen<'_>) -> Sight<'a> {
        let size = [image.width, image.height];
        let camera = CameraUniform::new(seen.camera, image.width, image.height);
        Sight { camera, size, depths: image.channel("Z"), scale: seen.scale }
    }

    /// The pixel in which the camera sees a position of a surface; `None` if it does not.
    fn pixel(&self, position: Vec3) -> Option<[u32; 2]> {
        let camera = &self.camera;
        let [right, up, backward] = [camera.right, camera.up, camera.backward].map(Vec3::from);
        let offset = position - Vec3::from(camera.position);
        let depth = -offset.dot(backward);
        let distance = if camera.orthographic == 1 { 1.0 } else { depth };
        let at = [offset.dot(right) / right.length_squared(), -offset.dot(up) / up.length_squared()];
        let at = at.map(|x| 0.5 + 0.5 * x / distance);
        if depth <= camera.near || at.iter().any(|x| !(0.0..1.0).contains(x)) {
            return None;
        }
        let [x, y] = [(at[0] * self.size[0] as f32) as u32, (at[1] * self.size[1] as f32) as u32];
        let surface = self.depths.map_or(f64::INFINITY, |depths| f64::from(depths[(y * self.size[0] + x) as usize]));
        (f64::from(depth) / self.scale <= surface * (1.0 + PHOTON_DEPTH)).then_some([x, y])
    }

    /// Paints the square of pixels around a position that are at most `radius` away, if the camera sees the position.
    fn paint(&self, pixels: &mut [u8], position: Vec3, radius: u32, colour: [u8; 3]) {
        let Some([x, y]) = self.pixel(position) else { return };
        let [width, height] = self.size;
        for y in y.saturating_sub(radius)..(y + radius + 1).min(height) {
            for x in x.saturating_sub(radius)..(x + radius + 1).min(width) {
                let first = 3 * (y * width + x) as usize;
                pixels[first..first + 3].copy_from_slice(&colour);
            }
        }
    }
}

fn photon_colour(photon: &VisibilityPhoton) -> [u8; 3] {
    if photon.is_shadow { SHADOW } else { ILLUMINATION }
}

/// Marks the pixels in which the camera sees a photon of a light.
fn draw_photons(pixels: &mut [u8], image: &Image, light: usize, seen: Seen<'_>) {
    let sight = Sight::new(image, seen);
    for photon in seen.photons.iter().filter(|photon| photon.light as usize == light) {
        sight.paint(pixels, photon.position, 0, photon_colour(photon));
    }
}

/// Marks a point, the photons that decided it, and the rim of the disc in which they are.
fn mark_nearest(pixels: &mut [u8], image: &Image, nearest: &NearestPhotons, seen: Seen<'_>) {
    let sight = Sight::new(image, seen);
    let NearestPhotons { point, photons, radius, .. } = nearest;
    let (u, v) = point.normal.any_orthonormal_pair();
    for step in 0..CIRCLE_POINTS {
        let angle = f64::from(step) / f64::from(CIRCLE_POINTS) * std::f64::consts::TAU;
        let offset = f64::from(*radius) * (angle.cos() * u + angle.sin() * v);
        sight.paint(pixels, point.position + offset.as_vec3(), 0, MARK);
    }
    for photon in photons {
        sight.paint(pixels, photon.position, 1, photon_colour(photon));
    }
    sight.paint(pixels, point.position, 1, MARK);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pixels with every channel that overlays show.
    fn image() -> Image {
        let mut image = Image::new(2, 1);
        for (name, samples) in [
            ("R", [0.0, 1.0]),
            ("G", [0.0, 1.0]),
            ("B", [0.0, 1.0]),
            ("denoised.R", [0.09, 0.99]),
            ("denoised.G", [0.09, 0.99]),
            ("denoised.B", [0.09, 0.99]),
            ("relative_error", [0.001, 1.0]),
            ("samples", [2.0, 8.0]),
            ("N.X", [1.0, -1.0]),
            ("N.Y", [0.0, 0.0]),
            ("N.Z", [0.0, 0.0]),
            ("Z", [3.0, 1e10]),
            ("shadow.a.class", [1.0, 3.0]),
            ("shadow.a.ni", [36.0, 20.0]),
            ("shadow.b.class", [2.0, 4.0]),
        ] {
            image.add_channel(name, samples.to_vec());
        }
        image
    }

    fn shown(overlay: Overlay, light: usize) -> Vec<u8> {
        shown_of(&image(), overlay, light)
    }

    fn shown_of(image: &Image, overlay: Overlay, light: usize) -> Vec<u8> {
        let display = Display { overlay, light, view: View::Raw, exposure: 0.0, denoised: false };
        let camera = crate::Scene::default().frame_camera();
        pixels(image, &display, Seen { photons: &[], cells: None, nearest: None, camera: &camera, scale: 1.0 })
    }

    /// Cells have the hue of their class; cells of the map are darker, edges are darker still, and nothing is black.
    #[test]
    fn cells_have_shades_and_edges() {
        let cell = |class, kind, level, hash| ShownCell { class, kind, level, hash };
        let [lit, map] = [CellKind::Fine, CellKind::Map].map(|kind| cell(Class::Lit, kind, 0, 0xff));
        let finest = cell(Class::Boundary, CellKind::Fine, 4, 0xff);
        let cells = [lit, lit, map, map, cell(Class::Unknown, CellKind::None, 0, 0), finest, finest, finest];
        let colour = |pixel| cell_colour(&cells, pixel, 8);
        let shaded = |shade: f32| CLASS_COLOURS[1].map(|x| (f32::from(x) * shade) as u8);
        assert_eq!([colour(0), colour(1)], [shaded(1.0), shaded(CELL_EDGE)]);
        assert_eq!([colour(2), colour(3)], [shaded(MAP_CELL), shaded(MAP_CELL * CELL_EDGE)]);
        assert_eq!([colour(4), colour(5)], [[0; 3], CLASS_COLOURS[3]]);
        let other = [ShownCell { hash: 0x1ff, ..finest }, finest];
        assert_eq!(cell_colour(&other, 0, 2), CLASS_COLOURS[3], "parts of a pixel have no edges");
    }

    #[test]
    fn overlays_show_their_channels() {
        assert_eq!(shown(Overlay::Picture, 0), [0, 0, 0, 255, 255, 255]);
        assert_eq!(shown(Overlay::Classes, 0), [CLASS_COLOURS[1], CLASS_COLOURS[3]].concat());
        assert_eq!(shown(Overlay::Classes, 1), [CLASS_COLOURS[2], CLASS_COLOURS[4]].concat());
        assert_eq!(shown(Overlay::Samples, 0), [64, 64, 64, 255, 255, 255]);
        // A thousandth of the brightness, and all of it.
        assert_eq!(shown(Overlay::Error, 0), [0, 0, 0, 255, 255, 255]);
        assert_eq!(shown(Overlay::Normal, 0), [255, 128, 128, 0, 128, 128]);
        assert_eq!(shown(Overlay::Depth, 0), [255, 255, 255, 0, 0, 0]);
        let mut nothing = Image::new(1, 1);
        nothing.add_channel("Z", vec![1e10]);
        assert_eq!(shown_of(&nothing, Overlay::Depth, 0), [0; 3]);
        assert_eq!(shown(Overlay::Albedo, 0), [0; 6], "a missing channel is black");
    }

    #[test]
    fn photons_are_drawn_where_they_are_and_not_behind_surfaces() {
        let mut image = Image::new(4, 4);
        for name in ["R", "G", "B"] {
            image.add_channel(name, vec![0.0; 16]);
        }
        // The right half has a surface in front of the photons.
        image.add_channel("Z", (0..16).map(|i| if i % 4 < 2 { 1e10 } else { 0.1 }).collect());
        let camera = Camera {
            name: String::new(),
            position: glam::Vec3::ZERO,
            axes: [glam::Vec3::X, glam::Vec3::Y, glam::Vec3::Z],
            projection: crate::scene::Projection::Perspective { yfov: std::f32::consts::FRAC_PI_2, aspect: None },
            near: 0.01,
            far: 10.0,
            lens: None,
        };
        let photon = |x: f32, y: f32, z: f32, is_shadow: bool| VisibilityPhoton {
            position: glam::Vec3::new(x, y, z),
            normal: glam::DVec3::Z,
            light: 0,
            is_shadow,
        };
        // Left above, left below, hidden on the right, behind the camera, outside the image, of another light.
        let other = VisibilityPhoton { light: 1, ..photon(-1.5, -0.5, -2.0, false) };
        let photons = [
            photon(-1.5, 1.5, -2.0, false),
            photon(-0.5, -1.5, -2.0, true),
            photon(1.5, 1.5, -2.0, false),
            photon(-1.5, 1.5, 2.0, true),
            photon(-5.0, 0.0, -2.0, true),
            other,
        ];
        let display = Display { overlay: Overlay::Photons, light: 0, view: View::Raw, exposure: 0.0, denoised: false };
        let seen = Seen { photons: &photons, cells: None, nearest: None, camera: &camera, scale: 1.0 };
        let shown = pixels(&image, &display, seen);
        let mut expected = vec![0; 48];
        expected[0..3].copy_from_slice(&ILLUMINATION);
        expected[3 * 13..3 * 14].copy_from_slice(&SHADOW);
        assert_eq!(shown, expected);
    }
}
