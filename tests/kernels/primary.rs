//! Pass `primary` against f64 rays through the centres of pixels, and glTF's rules for the surfaces that they hit.

use std::sync::Arc;

use glam::{DMat2, DVec2, DVec3, DVec4, Mat2, Vec2, Vec3, Vec4};
use kernel_kit::{Gpu, POISON, TableFormat, kernel_test};
use penumbra::internal::kernels::INVALID_POINT;
use penumbra::internal::passes::primary::Primary;
use penumbra::internal::passes::{GuideSamples, Tile, TileBuffers};
use penumbra::internal::scene::{
    AlphaMode, Camera, ColourSpace, Filter, Material, Projection, Scene, Specular, Texture, TextureImage, TextureInfo,
    Transmission, Wrap,
};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::light::{Corners, sphere, square};
use crate::octahedral::oct_decode;
use crate::path::{camera, scene, surface};
use crate::random::Random;
use crate::stage::{Crossing, Stage, constant, crossings, hash, pixel_of, sobol1, whole};

/// Faults planted in the oracle, which the comparison must find.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Back faces of single-sided surfaces emit.
    Backs,
    /// Normals are on the front side.
    Facing,
    /// The near and the far plane are ignored.
    Planes,
    /// Masks and blending are ignored.
    Alpha,
    /// sRGB codes are taken as linear.
    Linear,
    /// All textures repeat.
    Wrap,
    /// All textures are filtered.
    Filter,
    /// Vertex colours are ignored.
    Colours,
    /// Shading normals are the geometric ones.
    Flat,
    /// Rays leave from the triangle, not from the smooth surface that it approximates.
    Facets,
    /// The geometric normal is the triangle's.
    FacetNormals,
    /// The depth is the distance.
    Depth,
    /// Chance decides nothing where it lets a ray pass.
    Chance,
}

const FAULTS: [Fault; 13] = [
    Fault::Backs,
    Fault::Facing,
    Fault::Planes,
    Fault::Alpha,
    Fault::Linear,
    Fault::Wrap,
    Fault::Filter,
    Fault::Colours,
    Fault::Flat,
    Fault::Facets,
    Fault::FacetNormals,
    Fault::Depth,
    Fault::Chance,
];

const SPHERE: u32 = 0;

/// Panels of all kinds before a slanting wall, and a smooth ball.
fn panels() -> Scene {
    let panel = |x: f64, y: f64, z: f64| -> Vec<Corners> {
        square(DVec3::new(x, y, z), DVec3::new(0.13, 0.01, 0.03), DVec3::new(0.0, 0.13, -0.04))
    };
    let back =
        |x: f64, y: f64, z: f64| -> Vec<Corners> { panel(x, y, z).into_iter().map(|[a, b, c]| [a, c, b]).collect() };
    let wall = square(DVec3::new(0.0, 0.0, -0.6), DVec3::new(0.7, 0.0, 0.2), DVec3::Y * 0.6);
    let near = square(DVec3::new(-0.07, 0.0, 1.7), DVec3::new(0.07, 0.0, 0.0), DVec3::new(0.0, 0.05, 0.12));
    let info = |texture| {
        let matrix = Mat2::from_cols(Vec2::new(1.7, 0.3), Vec2::new(-0.4, 1.6));
        Some(TextureInfo { texture, uv_set: 0, matrix, offset: Vec2::new(-0.8, -0.3) })
    };
    let plain = surface(0.5, 0.0);
    let base_colour = Vec4::new(0.9, 0.7, 0.8, 0.9);
    let textured =
        |texture| Material { base_colour, base_colour_texture: info(texture), double_sided: true, ..surface(0.5, 0.0) };
    let emits = Material { emissive: Vec3::new(1.0, 2.0, 3.0), ..plain.clone() };
    let meshes = [
        (sphere(DVec3::new(0.0, 0.0, 0.1), 0.15, 10), plain.clone()),
        (wall, plain.clone()),
        (near, plain.clone()),
        (panel(-0.4, 0.4, 0.2), emits.clone()),
        (back(-0.1, 0.4, 0.1), emits.clone()),
        (back(0.2, 0.4, 0.2), Material { double_sided: true, emissive_texture: info(3), ..emits }),
        (panel(0.45, 0.1, 0.2), textured(0)),
        (back(-0.4, 0.1, 0.2), textured(1)),
        (panel(-0.4, -0.2, 0.2), textured(2)),
        (panel(-0.1, -0.4, 0.3), Material { alpha: AlphaMode::Mask { cutoff: 0.45 }, ..textured(1) }),
        (panel(0.2, -0.4, 0.3), Material { alpha: AlphaMode::Blend, ..textured(2) }),
        (panel(0.45, -0.2, 0.2), Material { unlit: true, ..textured(0) }),
        (panel(0.5, 0.42, 0.1), Material { base_colour, ..plain }),
    ];
    let coloured = meshes.len() as u32 - 1;
    let mut scene = scene(&meshes, Vec::new());
    let mut random = Random(3);
    let mut image = |width: u32, height: u32| TextureImage {
        name: String::new(),
        width,
        height,
        texels: (0..width * height).map(|_| [(); 4].map(|()| (random.uniform() * 256.0) as u8)).collect(),
    };
    scene.images = vec![image(5, 4), image(3, 7)].into();
    let texture = |image, wrap, filter| Texture { image, wrap, filter, space: ColourSpace::Srgb };
    scene.textures = vec![
        texture(0, [Wrap::Repeat, Wrap::Mirror], Filter::Linear),
        texture(1, [Wrap::Clamp, Wrap::Repeat], Filter::Linear),
        texture(1, [Wrap::Mirror, Wrap::Clamp], Filter::Nearest),
        texture(0, [Wrap::Clamp, Wrap::Mirror], Filter::Nearest),
    ];
    for triangle in scene.triangles.clone() {
        for vertex in triangle.vertices {
            let vertex = &mut Arc::make_mut(&mut scene.vertices)[vertex as usize];
            vertex.uv[0] = Vec2::new(random.uniform() as f32, random.uniform() as f32) * 3.0 - 1.0;
            if triangle.material == SPHERE {
                vertex.normal = (vertex.position - Vec3::Z * 0.1).normalize();
            }
            if triangle.material == coloured {
                vertex.colour = Vec4::from_array([(); 4].map(|()| random.uniform() as f32));
            }
        }
    }
    scene
}

/// Views from the front, slightly aside; the near and far planes cut off parts of the nearest panel and of the wall.
fn cameras() -> [Camera; 2] {
    let view = camera(DVec3::new(0.05, 0.1, 2.0), DVec3::new(-0.02, -0.04, -1.0), 0.65);
    let perspective = Camera { near: 0.3, far: 2.65, ..view };
    let projection = Projection::Orthographic { xmag: 0.0, ymag: 0.7 };
    [perspective.clone(), Camera { projection, ..perspective }]
}

/// The visible surface of a pixel.
#[derive(Debug)]
struct Visible {
    position: DVec3,
    /// Origin of rays that leave it, and its maximum error by the rounding of normals.
    leaving: DVec3,
    moved: f64,
    distance: f64,
    depth: f64,
    /// Cosine between the ray and the surface's normal.
    cosine: f64,
    geometric: DVec3,
    shading: DVec3,
    emission: DVec3,
    base: DVec3,
    unlit: bool,
    /// Maximum rounding error of a colour.
    colour: f64,
    material: usize,
}

/// What a pixel shows.
#[derive(Debug)]
struct Seen {
    visible: Option<Visible>,
    /// 1 if chance decided about a surface in front or the visible one, and 1 if it chose the visible one; else 0.
    chance: [f64; 2],
}

/// The oracle for one image.
struct Oracle<'s> {
    scene: &'s Scene,
    camera: &'s Camera,
    tile: Tile,
    fault: Fault,
}

impl Oracle<'_> {
    /// The ray through the centre of a pixel, and the cosine between it and the viewing direction.
    fn ray(&self, pixel: usize) -> (DVec3, DVec3, f64) {
        let [right, up, backward] = self.camera.axes.map(|a| a.as_dvec3());
        let [width, height] = [self.tile.width, self.tile.height].map(f64::from);
        let at = DVec2::new((pixel % width as usize) as f64 + 0.5, (pixel / width as usize) as f64 + 0.5);
        let across = |half: f64| {
            right * half * width / height * (2.0 * at.x / width - 1.0) + up * half * (1.0 - 2.0 * at.y / height)
        };
        let position = self.camera.position.as_dvec3();
        match self.camera.projection {
            Projection::Perspective { yfov, .. } => {
                let direction = (across((f64::from(yfov) / 2.0).tan()) - backward).normalize();
                (position, direction, -direction.dot(backward))
            }
            Projection::Orthographic { ymag, .. } => (position + across(f64::from(ymag)), -backward, 1.0),
        }
    }

    /// What a pixel shows; an error where that depends on rounding.
    fn see(&self, pixel: usize) -> Result<Seen, ()> {
        let (origin, direction, cosine) = self.ray(pixel);
        let (near, far) = (f64::from(self.camera.near) / cosine, f64::from(self.camera.far) / cosine);
        let mut found: Option<Crossing> = None;
        let mut chance = [0.0; 2];
        for crossing in crossings(self.scene, origin, direction) {
            // Behind the surface found, only surfaces at the same distance matter.
            if found.is_some_and(|f| crossing.t > f.t + 1e-5) {
                break;
            }
            if self.fault != Fault::Planes {
                // Distances of up to 3, with some roundings of 6e-8 each: below 1e-6.
                if (crossing.t - near).abs().min((crossing.t - far).abs()) < 1e-5 {
                    return Err(());
                }
                if crossing.t < near || crossing.t > far {
                    continue;
                }
            } else if crossing.t < 0.0 {
                continue;
            }
            if crossing.doubtful() || found.is_some() {
                return Err(());
            }
            let (stopped, is_chance) = self.stops(pixel, &crossing)?;
            if stopped {
                found = Some(crossing);
            }
            if is_chance && (stopped || self.fault != Fault::Chance) {
                chance = [1.0, f64::from(stopped)];
            }
        }
        let visible = found.map(|crossing| self.shade(&crossing, origin, direction, cosine)).transpose()?;
        Ok(Seen { visible, chance })
    }

    /// Whether a surface stops the ray, and whether chance decides.
    fn stops(&self, pixel: usize, crossing: &Crossing) -> Result<(bool, bool), ()> {
        let material = &self.scene.materials[self.scene.triangles[crossing.triangle].material as usize];
        let alpha = f64::from(material.base_colour.w) * self.texel(&material.base_colour_texture, crossing)?.w;
        let threshold = match material.alpha {
            _ if self.fault == Fault::Alpha => return Ok((true, false)),
            AlphaMode::Opaque => return Ok((true, false)),
            AlphaMode::Mask { cutoff } => f64::from(cutoff),
            AlphaMode::Blend => {
                let (seed, sample) = pixel_of(&self.tile, pixel);
                let sequence = hash(&[seed, constant("DIMENSION_ALPHA")]);
                sobol1(sample, hash(&[sequence, crossing.triangle as u32, 0x616c_7068]))
            }
        };
        let is_chance = material.alpha == AlphaMode::Blend && alpha > 0.0 && alpha < 1.0;
        if (alpha - threshold).abs() < TEXEL { Err(()) } else { Ok((alpha > threshold, is_chance)) }
    }

    fn shade(&self, crossing: &Crossing, origin: DVec3, direction: DVec3, cosine: f64) -> Result<Visible, ()> {
        let triangle = &self.scene.triangles[crossing.triangle];
        let material = &self.scene.materials[triangle.material as usize];
        let corners = triangle.vertices.map(|v| self.scene.vertices[v as usize]);
        let weights = [1.0 - crossing.u - crossing.v, crossing.u, crossing.v];
        let front = crossing.normal.dot(direction) < 0.0;
        let faced = |n: DVec3| if front || self.fault == Fault::Facing { n } else { -n };
        let position = origin + direction * crossing.t;
        let (mut leaving, mut geometric, mut moved) = (position, crossing.normal, 0.0);
        let mut shading = crossing.normal;
        if corners[0].normal != Vec3::ZERO && self.fault != Fault::Flat {
            shading = (0..3).map(|i| weights[i] * corners[i].normal.as_dvec3()).sum::<DVec3>().normalize();
            // At the rim the pass bends the normal towards the viewer; the oracle does not repeat by how much.
            if faced(shading).dot(-direction) < 2e-3 {
                return Err(());
            }
            // The sum of the projections onto the tangent planes that are above the point (Hanika 2021). Seen from
            // inside, the ball is hollow, and they are below it.
            let projections = (0..3).map(|i| {
                let (corner, normal) = (corners[i].position.as_dvec3(), faced(corners[i].normal.as_dvec3()));
                let from_corner = position - corner;
                weights[i] * (from_corner - normal * from_corner.dot(normal).min(0.0))
            });
            if self.fault != Fault::Facets {
                leaving += projections.sum::<DVec3>();
                let size =
                    (0..3).map(|i| corners[i].position.distance(corners[(i + 1) % 3].position)).fold(0.0, f32::max);
                moved = NORMAL * f64::from(size);
            }
            if self.fault != Fault::FacetNormals {
                geometric = shading;
            }
        }
        let mut base = material.base_colour.as_dvec4() * self.texel(&material.base_colour_texture, crossing)?;
        if self.fault != Fault::Colours {
            base *= (0..3).map(|i| weights[i] * corners[i].colour.as_dvec4()).sum::<DVec4>();
        }
        let base = base.truncate();
        let textured = material.base_colour_texture.is_some() || material.emissive_texture.is_some();
        let shines = front || material.double_sided || self.fault == Fault::Backs;
        let mut emission = DVec3::ZERO;
        if material.unlit {
            emission = base;
        } else if shines {
            emission = material.emissive.as_dvec3() * self.texel(&material.emissive_texture, crossing)?.truncate();
        }
        Ok(Visible {
            position,
            leaving,
            moved,
            distance: crossing.t,
            depth: crossing.t * if self.fault == Fault::Depth { 1.0 } else { cosine },
            cosine: crossing.normal.dot(direction).abs(),
            geometric: faced(geometric),
            shading: faced(shading),
            emission,
            base,
            unlit: material.unlit,
            colour: f64::from(material.emissive.max_element().max(1.0)) * if textured { TEXEL } else { COLOUR },
            material: triangle.material as usize,
        })
    }

    /// A texture at a point of a triangle; ones where there is none.
    fn texel(&self, info: &Option<TextureInfo>, crossing: &Crossing) -> Result<DVec4, ()> {
        let Some(info) = info else { return Ok(DVec4::ONE) };
        let texture = &self.scene.textures[info.texture as usize];
        let image = &self.scene.images[texture.image as usize];
        let corners = self.scene.triangles[crossing.triangle].vertices;
        let [a, b, c] = corners.map(|v| self.scene.vertices[v as usize].uv[0].as_dvec2());
        let uv = a + crossing.u * (b - a) + crossing.v * (c - a);
        let matrix = DMat2::from_cols(info.matrix.x_axis.as_dvec2(), info.matrix.y_axis.as_dvec2());
        let position =
            (matrix * uv + info.offset.as_dvec2()) * DVec2::new(f64::from(image.width), f64::from(image.height));
        let wrapped = |i: f64, size: u32, wrap: Wrap| {
            let (i, n) = (i as i64, i64::from(size));
            match wrap {
                _ if self.fault == Fault::Wrap => i.rem_euclid(n),
                Wrap::Repeat => i.rem_euclid(n),
                Wrap::Mirror => i.rem_euclid(2 * n).min(2 * n - 1 - i.rem_euclid(2 * n)),
                Wrap::Clamp => i.clamp(0, n - 1),
            }
        };
        let at = |x: f64, y: f64| {
            let (x, y) = (wrapped(x, image.width, texture.wrap[0]), wrapped(y, image.height, texture.wrap[1]));
            let code = image.texels[(x + y * i64::from(image.width)) as usize].map(|c| f64::from(c) / 255.0);
            let light = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
            let light = |c: f64| if self.fault == Fault::Linear { c } else { light(c) };
            DVec4::new(light(code[0]), light(code[1]), light(code[2]), code[3])
        };
        if texture.filter == Filter::Nearest && self.fault != Fault::Filter {
            // Texels begin at whole numbers.
            // Barycentric coordinates are off by 4e-7 (1e-7 of panels of 0.26), over at most 40 texels: 2e-5.
            let to_border = (position - position.round()).abs().min_element();
            return if to_border < 1e-4 { Err(()) } else { Ok(at(position.x.floor(), position.y.floor())) };
        }
        let corner = (position - 0.5).floor();
        let f = position - 0.5 - corner;
        let row = |y: f64| at(corner.x, y).lerp(at(corner.x + 1.0, y), f.x);
        Ok(row(corner.y).lerp(row(corner.y + 1.0), f.y))
    }
}

/// Everything that the pass writes.
#[derive(Clone, PartialEq)]
struct Outcome {
    points: Vec<[u32; 4]>,
    surfaces: Vec<[u32; 4]>,
    radiance: Vec<[u32; 4]>,
    albedo: Vec<[u32; 4]>,
    normals: Vec<[u32; 4]>,
    positions: Vec<[u32; 4]>,
    guide_albedo: Vec<[u32; 4]>,
    guide_normals: Vec<[u32; 4]>,
    guide_positions: Vec<[u32; 4]>,
}

impl Outcome {
    fn lists(&self) -> [&Vec<[u32; 4]>; 9] {
        [
            &self.points,
            &self.surfaces,
            &self.radiance,
            &self.albedo,
            &self.normals,
            &self.positions,
            &self.guide_albedo,
            &self.guide_normals,
            &self.guide_positions,
        ]
    }
}

fn with_all_outputs(features: Features) -> Features {
    let outputs = [Feature::AovAlbedo, Feature::AovNormal, Feature::AovPosition, Feature::Guides];
    outputs.into_iter().fold(features, |features, output| features.with(output, true))
}

fn stage(gpu: &Gpu, camera: &Camera, size: [u32; 2]) -> Stage {
    Stage::new(gpu, panels(), camera, size, Technique::TWO_PASS, with_all_outputs)
}

/// Room for the guides of one point more than `count`.
fn poisoned_guides(gpu: &Gpu, count: usize) -> GuideSamples {
    // Parts of a buffer begin at multiples of 256 bytes.
    let room = (count + 1).next_multiple_of(16);
    GuideSamples::of(gpu.poisoned::<[u32; 4]>("test/guides", 3 * room).unwrap())
}

fn run(gpu: &Gpu, stage: &Stage, tile: &Tile) -> Outcome {
    let pass = Primary::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
    let count = tile.point_count as usize;
    // One more, which must stay poisoned.
    let poisoned = |name: &str| gpu.poisoned::<[u32; 4]>(name, count + 1).unwrap();
    let mut buffers = TileBuffers::new(gpu, &stage.features, tile.point_count, false).unwrap();
    buffers.points = gpu.table_of(poisoned("test/points"), TableFormat::Uint).unwrap();
    buffers.surfaces = gpu.table_of(poisoned("test/surfaces"), TableFormat::Uint).unwrap();
    buffers.radiance_direct = poisoned("test/radiance");
    buffers.albedo_samples = Some(poisoned("test/albedo"));
    buffers.normal_samples = Some(poisoned("test/normals"));
    buffers.position_samples = Some(poisoned("test/positions"));
    buffers.guides = Some(poisoned_guides(gpu, count));
    let bound = pass.bind(gpu, &buffers, &stage.gpu_scene).unwrap();
    let mut frame = gpu.frame("test");
    bound.record(&mut frame, tile);
    frame.submit().unwrap();
    assert_eq!(gpu.read::<u32>(&buffers.counters, Counter::COUNT).unwrap(), [0; Counter::COUNT]);
    let read = |buffer: &kernel_kit::Buffer| -> Vec<[u32; 4]> {
        let mut words: Vec<[u32; 4]> = gpu.read(buffer, count + 1).unwrap();
        assert_eq!(words.pop(), Some([POISON; 4]), "past the end of {}", buffer.label);
        words
    };
    let guides = buffers.guides.as_ref().unwrap();
    Outcome {
        points: read(&buffers.points.buffer),
        surfaces: read(&buffers.surfaces.buffer),
        radiance: read(&buffers.radiance_direct),
        albedo: read(buffers.albedo_samples.as_ref().unwrap()),
        normals: read(buffers.normal_samples.as_ref().unwrap()),
        positions: read(buffers.position_samples.as_ref().unwrap()),
        guide_albedo: read(&guides.albedo),
        guide_normals: read(&guides.normal),
        guide_positions: read(&guides.position),
    }
}

/// Error of textures' colours: a device may decode sRGB to within half of one part in 255. The effect of rounded
/// texture coordinates is far less.
const TEXEL: f64 = 2e-3;

/// Error of other colours: vertex colours have 16 bits, and barycentric weights a few roundings.
const COLOUR: f64 = 2e-5;

/// An octahedral code is within 7e-5 of its vector; shading normals pass through two.
const NORMAL: f64 = 2e-4;

/// Whether the output for a pixel is that of the oracle.
fn same(outcome: &Outcome, i: usize, Seen { visible, chance }: &Seen) -> bool {
    let vector = |list: &Vec<[u32; 4]>| Vec4::from_array(list[i].map(f32::from_bits)).as_dvec4();
    let [point, packed, radiance, albedo, normal, position, guide_albedo, guide_normal, guide_position] =
        outcome.lists();
    let told = vector(guide_albedo).w == chance[0] && vector(guide_normal).w == chance[1];
    let Some(visible) = visible else {
        let others = [radiance, albedo, normal, position, guide_position];
        let guides = [guide_albedo, guide_normal];
        return told
            && guides.iter().all(|list| list[i][..3] == [0; 3])
            && point[i] == [0, 0, 0, INVALID_POINT]
            && packed[i] == [POISON; 4]
            && others.iter().all(|list| list[i] == [0; 4]);
    };
    let near = |got: DVec3, expected: DVec3, tolerance: f64| (got - expected).abs().max_element() <= tolerance;
    let colour = |list: &Vec<[u32; 4]>, expected: DVec3| {
        near(vector(list).truncate(), expected, visible.colour) && vector(list).w == 1.0
    };
    // Roundings of the direction, over the distance, along the surface.
    let tolerance = 1e-6 * visible.distance / visible.cosine;
    let lit = if visible.unlit {
        point[i] == [0, 0, 0, INVALID_POINT]
    } else {
        near(vector(point).truncate(), visible.leaving, tolerance + visible.moved)
            && near(oct_decode(point[i][3], 16), visible.geometric, NORMAL)
    };
    let reflected = if visible.unlit { DVec3::ZERO } else { visible.base };
    told && lit
        && near(vector(packed).truncate(), reflected, visible.colour)
        && near(oct_decode(packed[i][3], 16), visible.shading, NORMAL)
        && colour(radiance, visible.emission)
        && colour(albedo, visible.base)
        && near(vector(normal).truncate(), visible.shading, NORMAL)
        && vector(normal).w == 1.0
        && near(vector(position).truncate(), visible.position, tolerance)
        && (vector(position).w - visible.depth).abs() <= tolerance
        // There are neither mirrors nor clear glass.
        && guide_albedo[i][..3] == albedo[i][..3]
        && guide_normal[i][..3] == normal[i][..3]
        && guide_position[i][..3] == position[i][..3]
        && vector(guide_position).w == 1.0
}

#[kernel_test("PENUMBRA_DEVICE")]
fn pixels_show_what_rays_in_f64_meet(gpu: &Gpu) {
    for camera in cameras() {
        for size in [[1, 1], [63, 1], [64, 1], [13, 5], [120, 90]] {
            let stage = stage(gpu, &camera, size);
            let tile = Tile { centred: 1.0, ..whole(size, 1) };
            let outcome = run(gpu, &stage, &tile);
            let count = tile.pixel_count as usize;
            let (mut doubtful, mut missed) = (0, 0);
            let mut differences = |fault: Fault| {
                let oracle = Oracle { scene: &stage.scene, camera: &camera, tile, fault };
                let differs = |i: &usize| match oracle.see(*i) {
                    Err(()) => {
                        doubtful += usize::from(fault == Fault::None);
                        false
                    }
                    Ok(seen) => {
                        missed += usize::from(fault == Fault::None && seen.visible.is_none());
                        !same(&outcome, *i, &seen)
                    }
                };
                (0..count).filter(differs).collect::<Vec<usize>>()
            };
            let wrong = differences(Fault::None);
            if let Some(first) = wrong.first() {
                let oracle = Oracle { scene: &stage.scene, camera: &camera, tile, fault: Fault::None };
                let got = outcome.lists().map(|list| list[*first].map(f32::from_bits));
                panic!("{size:?}: pixels {wrong:?}, of which the first has {got:?}, not {:?}", oracle.see(*first));
            }
            if count < 1000 {
                continue;
            }
            for fault in FAULTS {
                // In an orthographic view the distance is the depth.
                let orthographic = matches!(camera.projection, Projection::Orthographic { .. });
                if !(orthographic && fault == Fault::Depth) {
                    let found = differences(fault).len();
                    assert!(found > 20, "{fault:?}: {found} differences");
                }
            }
            assert!(doubtful * 200 < count, "{doubtful} of {count} pixels hang on rounding");
            assert!(missed > 20, "no pixel shows nothing");
            let oracle = Oracle { scene: &stage.scene, camera: &camera, tile, fault: Fault::None };
            let mut met = vec![0; stage.scene.materials.len()];
            (0..count).filter_map(|i| oracle.see(i).ok()?.visible).for_each(|visible| met[visible.material] += 1);
            assert!(met.iter().all(|n| *n > 20), "pixels of each material: {met:?}");
        }
    }
}

/// Runs the pass for a view of specular surfaces. All outputs have room for one more point.
fn trace_chains(gpu: &Gpu, scene: Scene, camera: &Camera, size: [u32; 2], samples: u32) -> TileBuffers {
    let stage = Stage::new(gpu, scene, camera, size, Technique::TWO_PASS, with_all_outputs);
    assert!(stage.features.has(Feature::SpecularChains), "no mirror and no clear glass");
    let tile = Tile { centred: 1.0, ..whole(size, samples) };
    let pass = Primary::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
    let count = tile.point_count as usize;
    let mut buffers = TileBuffers::new(gpu, &stage.features, tile.point_count, false).unwrap();
    let poisoned = |name: &str| Some(gpu.poisoned::<[u32; 4]>(name, count + 1).unwrap());
    buffers.albedo_samples = poisoned("test/albedo");
    buffers.normal_samples = poisoned("test/normals");
    buffers.position_samples = poisoned("test/positions");
    buffers.guides = Some(poisoned_guides(gpu, count));
    let mut frame = gpu.frame("test");
    pass.bind(gpu, &buffers, &stage.gpu_scene).unwrap().record(&mut frame, &tile);
    frame.submit().unwrap();
    buffers
}

/// What the pass writes for a view of specular surfaces: albedo, normal and position as AOVs, then as guides.
fn seen_over_chains(gpu: &Gpu, scene: Scene, camera: &Camera, size: [u32; 2], samples: u32) -> [Vec<Vec4>; 6] {
    let buffers = trace_chains(gpu, scene, camera, size, samples);
    let count = (size[0] * size[1] * samples) as usize;
    let read = |buffer: &kernel_kit::Buffer| -> Vec<Vec4> {
        let mut words: Vec<[u32; 4]> = gpu.read(buffer, count + 1).unwrap();
        assert_eq!(words.pop(), Some([POISON; 4]), "past the end of {}", buffer.label);
        words.iter().map(|vector| Vec4::from_array(vector.map(f32::from_bits))).collect()
    };
    let aovs = [&buffers.albedo_samples, &buffers.normal_samples, &buffers.position_samples];
    let [albedo, normal, position] = aovs.map(|aov| read(aov.as_ref().unwrap()));
    let guides = buffers.guides.as_ref().unwrap();
    [albedo, normal, position, read(&guides.albedo), read(&guides.normal), read(&guides.position)]
}

/// A mirror, and behind the camera that looks at it a wall which shines.
fn mirror_and_wall() -> (Scene, Camera) {
    let mirror = square(DVec3::new(0.0, 0.0, -0.5), DVec3::X * 0.6, DVec3::Y * 0.6);
    let wall = square(DVec3::new(0.0, 0.0, 0.6), DVec3::NEG_X * 0.7, DVec3::Y * 0.7);
    let polished = |base_colour: Vec4| Material { base_colour, metallic: 1.0, roughness: 0.0, ..surface(0.5, 0.0) };
    // Specular chains are followed only in a scene with light.
    let painted = Material { base_colour: Vec4::new(0.2, 0.4, 0.8, 1.0), ..surface(0.5, 1.0) };
    let scene = scene(&[(mirror, polished(Vec4::new(1.0, 0.8, 0.6, 1.0))), (wall, painted)], Vec::new());
    (scene, camera(DVec3::new(0.0, 0.0, 0.2), DVec3::new(0.0, 0.0, -0.5), 1.0))
}

/// A mirror that fills the image reflects each ray once: invocations beyond the last point trace nothing, and no
/// counter has their rays.
#[kernel_test("PENUMBRA_DEVICE")]
fn each_point_is_traced_once(gpu: &Gpu) {
    for (size, samples) in [([1, 1], 1), ([1, 1], 3), ([9, 9], 3), ([8, 8], 2), ([5, 13], 7)] {
        let (scene, camera) = mirror_and_wall();
        let buffers = trace_chains(gpu, scene, &camera, size, samples);
        let counters = gpu.read::<u32>(&buffers.counters, Counter::COUNT).unwrap();
        assert_eq!(counters[Counter::BounceRays as usize], size[0] * size[1] * samples, "{size:?} x {samples}");
    }
}

/// A mirror in front of the camera, and behind the camera a wall: the guides are of the wall, in the mirror's colour.
#[kernel_test("PENUMBRA_DEVICE")]
fn guides_are_of_what_a_mirror_shows(gpu: &Gpu) {
    let (scene, camera) = mirror_and_wall();
    let seen = seen_over_chains(gpu, scene, &camera, [9, 9], 1);
    let centre = seen.each_ref().map(|list| list[list.len() / 2]);
    let [albedo, normal, _, guide_albedo, guide_normal, guide_position] = centre;
    // Values of f32 that a sum over one sample does not change.
    assert!((albedo - Vec4::new(1.0, 0.8, 0.6, 1.0)).abs().max_element() < 1e-6, "the AOV is the mirror's: {albedo}");
    assert!((normal - Vec4::new(0.0, 0.0, 1.0, 1.0)).abs().max_element() < 1e-6, "{normal}");
    // The mirror reflects its colour straight on, and chance decides nothing.
    assert!((guide_albedo - Vec4::new(0.2, 0.32, 0.48, 0.0)).abs().max_element() < 1e-6, "{guide_albedo}");
    assert!((guide_normal - Vec4::new(0.0, 0.0, -1.0, 0.0)).abs().max_element() < 1e-6, "{guide_normal}");
    // The narrowest lobe, of alpha 0.001, turns rays by some thousandths over a distance of 1.1.
    assert!((guide_position - Vec4::new(0.0, 0.0, 0.6, 1.0)).abs().max_element() < 5e-3, "{guide_position}");
}

/// A pane of clear glass between two walls: the guides belong to the wall in front if the ray is refracted, and to the
/// wall behind the camera if it is reflected. Chance decides which.
#[kernel_test("PENUMBRA_DEVICE")]
fn guides_tell_what_chance_chose(gpu: &Gpu) {
    let pane = square(DVec3::ZERO, DVec3::X * 0.4, DVec3::Y * 0.4);
    let front = square(DVec3::new(0.0, 0.0, -0.5), DVec3::X * 1.3, DVec3::Y * 1.3);
    let behind = square(DVec3::new(0.0, 0.0, 0.6), DVec3::NEG_X * 1.3, DVec3::Y * 1.3);
    let glass = Material {
        roughness: 0.0,
        transmission: Transmission::with_factor(1.0),
        specular: Specular::default(),
        ..surface(1.0, 0.0)
    };
    let scene = scene(&[(pane, glass), (front, surface(0.5, 1.0)), (behind, surface(0.25, 1.0))], Vec::new());
    let camera = camera(DVec3::new(0.0, 0.0, 0.3), DVec3::NEG_Z, 2.0);
    let [_, _, first, albedo, normal, position] = seen_over_chains(gpu, scene, &camera, [40, 40], 4);
    let mut counts = [0; 3];
    for i in 0..first.len() {
        // Beside the pane chance decides nothing.
        // The pane is at z = 0, the walls half a unit before and behind it.
        let on_pane = first[i].z.abs() < 1e-3;
        let reflected = position[i].z > 0.5;
        counts[usize::from(on_pane) + usize::from(reflected)] += 1;
        let expected = [on_pane, reflected].map(|is_so| f32::from(u8::from(is_so)));
        assert_eq!([albedo[i].w, normal[i].w], expected, "sample {i} at {} of {}", position[i], first[i]);
    }
    // Fresnel: 4 % at the middle, and more towards the sides.
    assert!(counts.iter().all(|count| *count > 100), "samples beside the pane, through it, and reflected: {counts:?}");
}

/// Tiles of rows, parts of the image, and samples rendered one by one, give the same bits as the whole image.
#[kernel_test("PENUMBRA_DEVICE")]
fn tiles_and_samples_are_the_whole(gpu: &Gpu) {
    const SAMPLES: u32 = 4;
    let size = [41, 13];
    let camera = &cameras()[0];
    let stage = stage(gpu, camera, size);
    let all = Tile { first_sample: 2, ..whole(size, SAMPLES) };
    let outcome = run(gpu, &stage, &all);
    let piece = |first_row: u32, rows: u32, sample: u32, samples_per_pixel: u32| {
        let pixel_count = rows * size[0];
        let point_count = pixel_count * samples_per_pixel;
        let of_rows = Tile { first_row, pixel_count, ..all };
        Tile { samples_per_pixel, point_count, first_sample: all.first_sample + sample, ..of_rows }
    };
    let differences = |tile: &Tile, first: u32| -> usize {
        let got = run(gpu, &stage, tile);
        let index = |i: usize| {
            let (pixel, sample) = (i as u32 / tile.samples_per_pixel, i as u32 % tile.samples_per_pixel);
            let [x, y] = [tile.first_column + pixel % tile.columns, tile.first_row + pixel / tile.columns];
            ((y * size[0] + x) * SAMPLES + first + sample) as usize
        };
        let differs = |i: &usize| got.lists().iter().zip(outcome.lists()).any(|(a, b)| a[*i] != b[index(*i)]);
        (0..tile.point_count as usize).filter(differs).count()
    };
    for (first_row, rows) in [(0, 5), (5, 1), (6, 7)] {
        assert_eq!(differences(&piece(first_row, rows, 0, SAMPLES), 0), 0, "rows from {first_row}");
    }
    // Some columns of some rows.
    let part = Tile { first_column: 7, columns: 20, pixel_count: 100, point_count: 400, ..piece(6, 5, 0, SAMPLES) };
    assert_eq!(differences(&part, 0), 0, "a part of the image");
    for sample in 0..SAMPLES {
        assert_eq!(differences(&piece(0, 13, sample, 1), sample), 0, "sample {sample}");
    }
    let others = differences(&piece(0, 13, 1, 1), 2);
    assert!(others > 100, "samples that are alike: {others} differences");

    // Samples lie within their pixels.
    let half = match camera.projection {
        Projection::Perspective { yfov, .. } => f64::from(yfov / 2.0).tan(),
        Projection::Orthographic { .. } => unreachable!("the first camera is a perspective one"),
    };
    let [right, up, backward] = camera.axes.map(|a| a.as_dvec3());
    let [width, height] = size.map(f64::from);
    // Position in the pixel of a sample, in pixels.
    let in_pixel = |i: usize, position: [u32; 4]| {
        let p = Vec4::from_array(position.map(f32::from_bits)).truncate().as_dvec3() - camera.position.as_dvec3();
        let scale = 0.5 * height / half / -p.dot(backward);
        let film = DVec2::new(0.5 * width + p.dot(right) * scale, 0.5 * height - p.dot(up) * scale);
        let pixel = i / SAMPLES as usize;
        film - DVec2::new((pixel % size[0] as usize) as f64, (pixel / size[0] as usize) as f64)
    };
    let within = |i: usize, shift: f64| {
        let offset = in_pixel(i, outcome.points[i]) - DVec2::X * shift;
        // Error of f32 positions, relative to pixels of a fiftieth of the view.
        offset.min_element() > -1e-4 && offset.max_element() < 1.0 + 1e-4
    };
    let valid: Vec<usize> = (0..all.point_count as usize).filter(|i| outcome.points[*i][3] != INVALID_POINT).collect();
    let outside: Vec<usize> = valid.iter().copied().filter(|i| !within(*i, 0.0)).collect();
    assert!(valid.len() > 300 && outside.is_empty(), "{outside:?} of {}", valid.len());
    assert!(
        valid.iter().filter(|i| !within(**i, 0.5)).count() > valid.len() / 4,
        "an offset of half a pixel is not found"
    );

    // Or they lie in a smaller square around the pixel's centre, and in all of it. Points of the ball are not on their
    // rays, but the positions of the image are.
    let near = run(gpu, &stage, &Tile { centred: 0.75, ..all });
    let is_valid = |i: &usize| near.points[*i][3] != INVALID_POINT;
    let from_centre = |i: usize| in_pixel(i, near.positions[i]) - 0.5;
    let offsets: Vec<DVec2> = (0..all.point_count as usize).filter(is_valid).map(from_centre).collect();
    let [low, high] = [DVec2::min, DVec2::max].map(|end| offsets.iter().copied().reduce(end).unwrap());
    assert!(low.min_element() > -0.125 - 1e-4 && high.max_element() < 0.125 + 1e-4, "{low} to {high}");
    // Of more than 300 samples one is this near to each side, but once in 10^13.
    assert!(offsets.len() > 300 && low.max_element() < -0.1 && high.min_element() > 0.1, "{low} to {high}");
}

/// A normal map in its tangent frame, metallic and roughness from a texture, and a base colour from the second set of
/// texture coordinates: one pixel, against glTF's formulas (3.9.2, 3.9.3, B.3). The tangent is the file's, or that of
/// an upright image: its v runs down, and the green of a normal map points up.
#[kernel_test("PENUMBRA_DEVICE")]
fn normal_maps_glossy_textures_and_second_coordinates_are_gltfs(gpu: &Gpu) {
    let info = |texture, uv_set| Some(TextureInfo { texture, uv_set, matrix: Mat2::IDENTITY, offset: Vec2::ZERO });
    let material = Material {
        base_colour: Vec4::new(0.9, 0.8, 0.7, 1.0),
        metallic: 0.8,
        roughness: 0.9,
        specular: Specular { colour: Vec3::new(1.0, 0.9, 0.8), ..Specular::with_factor(0.6) },
        normal_scale: 0.7,
        base_colour_texture: info(0, 1),
        metallic_roughness_texture: info(1, 0),
        normal_texture: info(2, 0),
        ..surface(0.5, 0.0)
    };
    // The diagonals of its triangles do not pass through the centre of the image.
    let quad = square(DVec3::new(0.1, 0.0, 0.0), 0.5 * DVec3::X, 0.4 * DVec3::Y);
    let mut scene = scene(&[(quad, material.clone())], Vec::new());
    let image =
        |texels: Vec<[u8; 4]>| TextureImage { name: String::new(), width: texels.len() as u32, height: 1, texels };
    // The first set of coordinates gives black, the second white.
    scene.images =
        vec![image(vec![[0, 0, 0, 255], [255; 4]]), image(vec![[7, 100, 150, 255]]), image(vec![[170, 70, 210, 255]])]
            .into();
    let texture = |image, space| Texture { image, wrap: [Wrap::Clamp; 2], filter: Filter::Nearest, space };
    scene.textures =
        vec![texture(0, ColourSpace::Srgb), texture(1, ColourSpace::Linear), texture(2, ColourSpace::Linear)];
    let stated = Vec4::new(0.6, 0.8, 0.0, -1.0);
    for (stated, tangent) in [(stated, stated), (Vec4::ZERO, Vec4::new(1.0, 0.0, 0.0, 1.0))] {
        let mut scene = scene.clone();
        for vertex in Arc::make_mut(&mut scene.vertices) {
            let upright = 0.1 * Vec2::new(vertex.position.x, -vertex.position.y);
            vertex.uv = [Vec2::new(0.2, 0.5) + upright, Vec2::new(0.8, 0.5)];
            vertex.tangent = stated;
        }
        let view = camera(DVec3::new(0.0, 0.0, 1.0), DVec3::NEG_Z, 0.5);
        let stage = Stage::new(gpu, scene, &view, [1, 1], Technique::TWO_PASS, |features| features);
        for feature in [Feature::Glossy, Feature::Uv1, Feature::NormalMaps, Feature::Textures] {
            assert!(stage.features.has(feature), "{feature:?}");
        }
        let pass = Primary::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
        let buffers = TileBuffers::new(gpu, &stage.features, 1, false).unwrap();
        let bound = pass.bind(gpu, &buffers, &stage.gpu_scene).unwrap();
        let mut frame = gpu.frame("test");
        bound.record(&mut frame, &Tile { centred: 1.0, ..whole([1, 1], 1) });
        frame.submit().unwrap();
        let packed: Vec<[u32; 4]> = gpu.read(&buffers.surfaces.buffer, 3).unwrap();
        assert_surface(&packed, &material, tangent);
    }
}

/// Checks a surface that the test above shades, whose shading frame has the `tangent`.
fn assert_surface(packed: &[[u32; 4]], material: &Material, tangent: Vec4) {
    let [a, b, c] = [0, 1, 2].map(|i| Vec4::from_array(packed[i].map(f32::from_bits)).as_dvec4());
    let m = |x: f32| f64::from(x);
    let base = material.base_colour.truncate().as_dvec3();
    let (roughness, metallic) = (m(material.roughness) * 100.0 / 255.0, m(material.metallic) * 150.0 / 255.0);
    let dielectric = (0.5f64 / 2.5).powi(2) * material.specular.colour.as_dvec3() * m(material.specular.factor);
    let f0 = dielectric.lerp(base, metallic);
    let f90 = m(material.specular.factor) * (1.0 - metallic) + metallic;
    let near = |got: f64, expected: f64| (got - expected).abs() < COLOUR;
    assert!((a.truncate() - base * (1.0 - metallic)).abs().max_element() < COLOUR, "albedo {a}");
    assert!((b.truncate() - f0).abs().max_element() < COLOUR && near(b.w, f90), "f0 {b}, expected {f0} and {f90}");
    assert!(near(c.x, dielectric.max_element()) && near(c.y, m(material.specular.factor)), "dielectric {c}");
    assert!(near(c.z, roughness * roughness), "alpha {c}");

    let texel = DVec3::new(170.0, 70.0, 210.0) / 255.0 * 2.0 - 1.0;
    let normal = |scale: f64, handedness: f64| {
        let tangent = tangent.truncate().as_dvec3();
        let bitangent = DVec3::Z.cross(tangent) * handedness;
        (texel.x * scale * tangent + texel.y * scale * bitangent + texel.z * DVec3::Z).normalize()
    };
    let got = oct_decode(packed[0][3], 16);
    let (scale, handedness) = (m(material.normal_scale), m(tangent.w));
    let expected = normal(scale, handedness);
    assert!((got - expected).abs().max_element() < NORMAL, "normal {got}, expected {expected}");
    let faults = [("scale", normal(1.0, handedness)), ("handedness", normal(scale, -handedness)), ("none", DVec3::Z)];
    for (fault, wrong) in faults {
        assert!((got - wrong).abs().max_element() > 100.0 * NORMAL, "the test does not see the fault {fault}");
    }
}
