//! The files in `scenes/` are those that the code beside them writes, and have the documented contents.

#[path = "../../scenes/generator/mod.rs"]
mod generator;

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat4, DVec3};
use penumbra::internal::scene::{ImportOptions, LightKind, Scene};

/// A triangle in world space, as (material's name, corners).
type Triangle = (String, [DVec3; 3]);

struct Contents {
    triangles: Vec<Triangle>,
    /// Position and direction of the camera.
    camera: (DVec3, DVec3),
}

fn parse(name: &str) -> gltf::Gltf {
    let (_, bytes) = generator::scenes().into_iter().find(|(scene, _)| *scene == name).unwrap();
    gltf::Gltf::from_slice(&bytes).unwrap()
}

/// The bytes of a tightly packed accessor.
fn bytes<'a>(accessor: &gltf::Accessor, blob: &'a [u8]) -> &'a [u8] {
    let view = accessor.view().unwrap();
    assert_eq!((view.stride(), accessor.offset()), (None, 0));
    &blob[view.offset()..][..accessor.count() * accessor.size()]
}

fn positions(primitive: &gltf::Primitive, blob: &[u8]) -> Vec<DVec3> {
    let accessor = primitive.get(&gltf::Semantic::Positions).unwrap();
    let floats: Vec<f64> =
        bytes(&accessor, blob).as_chunks().0.iter().map(|&x| f64::from(f32::from_le_bytes(x))).collect();
    floats.as_chunks().0.iter().copied().map(DVec3::from_array).collect()
}

fn indices(primitive: &gltf::Primitive, blob: &[u8]) -> Vec<usize> {
    let accessor = primitive.indices().unwrap();
    assert_eq!(accessor.data_type(), gltf::accessor::DataType::U16);
    bytes(&accessor, blob).as_chunks().0.iter().map(|&x| u16::from_le_bytes(x).into()).collect()
}

fn read(name: &str) -> Contents {
    let gltf::Gltf { document, blob } = parse(name);
    let blob = blob.unwrap();
    let mut contents = Contents { triangles: Vec::new(), camera: Default::default() };
    let mut nodes: Vec<_> = document.default_scene().unwrap().nodes().map(|node| (node, DMat4::IDENTITY)).collect();
    while let Some((node, parent)) = nodes.pop() {
        let local = node.transform().matrix().map(|column| column.map(f64::from));
        let world = parent * DMat4::from_cols_array_2d(&local);
        if node.camera().is_some() {
            contents.camera = (world.transform_point3(DVec3::ZERO), world.transform_vector3(-DVec3::Z));
        }
        for primitive in node.mesh().into_iter().flat_map(|mesh| mesh.primitives().collect::<Vec<_>>()) {
            let corners = positions(&primitive, &blob).into_iter().map(|p| world.transform_point3(p));
            let corners: Vec<DVec3> = corners.collect();
            let indices = indices(&primitive, &blob);
            let material = primitive.material().name().unwrap().to_owned();
            for triangle in indices.as_chunks::<3>().0 {
                contents.triangles.push((material.clone(), triangle.map(|corner| corners[corner])));
            }
        }
        nodes.extend(node.children().map(|child| (child, world)));
    }
    contents
}

impl Contents {
    fn of(&self, material: &str) -> Vec<[DVec3; 3]> {
        self.triangles.iter().filter(|(name, _)| name == material).map(|(_, corners)| *corners).collect()
    }
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize()
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

fn centroid([a, b, c]: [DVec3; 3]) -> DVec3 {
    (a + b + c) / 3.0
}

/// Positions in the file are f32 and at most 8 from the origin, where half an ulp is 2.4e-7.
const ROUNDING: f64 = 5e-7;

/// Every edge is shared by two triangles that run along it in opposite directions, corners equal to the bit.
#[track_caller]
fn assert_watertight(triangles: &[[DVec3; 3]]) {
    let key = |p: DVec3| p.to_array().map(f64::to_bits);
    let mut balance: HashMap<_, (i32, u32)> = HashMap::new();
    for [a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (from, to) = (key(*from), key(*to));
            let edge = balance.entry((from.min(to), from.max(to))).or_default();
            edge.0 += if from < to { 1 } else { -1 };
            edge.1 += 1;
        }
    }
    assert!(balance.values().all(|&edge| edge == (0, 2)));
}

#[test]
fn the_files_are_what_the_code_writes() {
    for (name, bytes) in generator::scenes() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name);
        let same = std::fs::read(&file).is_ok_and(|file| file == bytes);
        assert!(same, "scenes/{name} is not what its code writes: run `cargo run --release --example make_scenes`");
        assert!(bytes.len() < 1_500_000, "scenes/{name} is too large for a repository");
    }
}

#[test]
fn the_sphere_scene_has_its_measures() {
    let scene = read("sphere.glb");
    let ball = scene.of("marble");
    assert_watertight(&ball);
    for corners in &ball {
        assert!(corners.iter().all(|p| ((*p - DVec3::Y).length() - 1.0).abs() < ROUNDING));
        assert!(normal(*corners).dot(centroid(*corners) - DVec3::Y) > 0.0, "a triangle faces inwards");
    }
    // A facet of 2.5 degrees lies at most 1 - cos(1.25 degrees) * cos(1.25 degrees) within the sphere.
    let sagitta = 1.0 - 1.25f64.to_radians().cos().powi(2);
    assert!(ball.iter().all(|corners| (centroid(*corners) - DVec3::Y).length() > 1.0 - sagitta));

    let plane = scene.of("plane");
    assert!(plane.iter().flatten().all(|p| p.y == 0.0 && p.x.abs() == 6.0 && p.z.abs() == 6.0));
    assert_eq!(plane.iter().copied().map(area).sum::<f64>(), 144.0);
    assert!(plane.iter().all(|corners| normal(*corners) == DVec3::Y));

    let light = scene.of("light");
    let centre = DVec3::new(-3.0, 5.0, 2.0);
    assert_eq!(light.len(), 320);
    assert_watertight(&light);
    for corners in light {
        assert!(corners.iter().all(|p| ((*p - centre).length() - 0.15).abs() < ROUNDING));
        assert!(normal(corners).dot(centroid(corners) - centre) > 0.0, "an emitter triangle faces inwards");
    }
    let (eye, direction) = scene.camera;
    assert!(eye.distance(DVec3::new(0.0, 3.0, 8.0)) < ROUNDING);
    assert!(direction.distance(DVec3::new(0.0, -0.25, -0.97).normalize()) < ROUNDING);
}

#[test]
fn the_box_has_its_measures() {
    let scene = read("box.glb");
    let total = |material: &str| scene.of(material).into_iter().map(area).sum::<f64>();
    // Floor, ceiling and back wall of 4 each, and a cube of edge 0.7.
    // An area is off by its perimeter times the rounding of positions. The perimeters are 24 + 16.8.
    assert!((total("white") - (3.0 * 4.0 + 6.0 * 0.49)).abs() < 100.0 * ROUNDING);
    assert_eq!((total("red"), total("green")), (4.0, 4.0));
    // Its perimeter is 3.2, and its corners are below 1, where half of a unit in the last place of f32 is 3e-8.
    assert!((total("light") - 0.64).abs() < ROUNDING);
    assert_eq!(scene.triangles.len(), 24);

    let centre = DVec3::new(0.3, -0.65, 0.1);
    for (material, corners) in &scene.triangles {
        let (at, facing) = (centroid(*corners), normal(*corners));
        if material == "light" {
            assert!(facing == -DVec3::Y && corners.iter().all(|p| (p.y - 0.99).abs() < ROUNDING));
        } else if corners.iter().all(|p| p.abs().max_element() == 1.0) {
            assert!(facing.dot(at) < 0.0, "{material} faces away from the room");
            assert!(at.z < 1.0, "the front is open");
        } else {
            // The cube: a face's normal, turned back by 20 degrees, is an axis; the face lies 0.35 along it.
            let turned = DMat4::from_rotation_y(-20f64.to_radians()).transform_vector3(facing);
            assert!((turned.abs().max_element() - 1.0).abs() < ROUNDING);
            assert!((facing.dot(at - centre) - 0.35).abs() < ROUNDING);
        }
    }
    assert!(scene.camera.0.distance(3.6 * DVec3::Z) < ROUNDING && scene.camera.1.distance(-DVec3::Z) < ROUNDING);
}

#[test]
fn the_still_life_has_the_features_it_is_there_for() {
    let document = parse("still_life.glb").document;
    let alpha: Vec<_> = document.materials().map(|material| material.alpha_mode()).collect();
    for mode in [gltf::material::AlphaMode::Opaque, gltf::material::AlphaMode::Mask, gltf::material::AlphaMode::Blend] {
        assert!(alpha.contains(&mode), "{mode:?}");
    }
    assert!(document.materials().any(|material| material.normal_texture().is_some()));
    assert!(document.materials().any(|material| material.emissive_texture().is_some()));
    let colours = document.materials().filter_map(|material| material.pbr_metallic_roughness().base_color_texture());
    assert!(colours.map(|texture| texture.texture_transform()).any(|transform| transform.is_some()));
    let mut primitives = document.meshes().flat_map(|mesh| mesh.primitives().collect::<Vec<_>>());
    assert!(primitives.any(|primitive| primitive.get(&gltf::Semantic::Colors(0)).is_some()));
    assert_eq!(document.lights().unwrap().count(), 2);

    let scene = read("still_life.glb");
    // Solids are closed, or light would leak into them.
    for solid in ["glaze", "rough copper", "wax"] {
        assert_watertight(&scene.of(solid));
    }
}

#[test]
fn the_crowd_stands_on_its_plane() {
    let nodes = parse("crowd.glb").document.nodes().count();
    assert_eq!(nodes, 340 + 3, "objects, plane, light and camera");
    let scene = read("crowd.glb");
    let objects = scene.of("object");
    assert_eq!(scene.triangles.len(), 151_896, "the number in scenes/README.md");
    assert_watertight(&objects);
    assert!(objects.iter().flatten().all(|p| p.y > -ROUNDING && p.x.abs() < 6.0 && p.z.abs() < 6.0));
    assert!(scene.of("light").into_iter().all(|corners| normal(corners).distance(-DVec3::Y) < ROUNDING));
}

/// The segment between two points does not pass through a triangle.
fn is_clear(triangles: &[Triangle], from: DVec3, to: DVec3) -> bool {
    let way = to - from;
    triangles.iter().all(|(_, corners)| {
        let [a, b, c] = *corners;
        let across = (b - a).cross(c - a);
        let at = (a - from).dot(across) / way.dot(across);
        let met = from + at * way;
        let is_inside = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (*q - *p).cross(met - *p).dot(across) >= 0.0);
        !(is_inside && (1e-6..1.0 - 1e-6).contains(&at))
    })
}

/// Share of the floor of the room that sees the middle of its lamp.
fn lit_share_of_floor(scene: &Contents) -> f64 {
    let lamp = scene.of("lamp");
    let middle = lamp.iter().copied().map(centroid).sum::<DVec3>() / lamp.len() as f64;
    let others: Vec<Triangle> = scene.triangles.iter().filter(|(name, _)| name != "lamp").cloned().collect();
    let places = (0..44).flat_map(|x| (0..48).map(move |z| [x, z].map(f64::from)));
    let places: Vec<DVec3> = places.map(|[x, z]| DVec3::new(0.1 * x - 2.15, 1e-3, 0.1 * z - 2.35)).collect();
    places.iter().filter(|place| is_clear(&others, **place, middle)).count() as f64 / places.len() as f64
}

/// The lamp behind the door lights a strip of the floor, that of the uplight none.
#[test]
fn two_rooms_are_lit_indirectly() {
    let door = lit_share_of_floor(&read("door.glb"));
    assert!(door > 0.005 && door < 0.15, "{door} of the floor sees the lamp behind the door");
    assert_eq!(lit_share_of_floor(&read("uplight.glb")), 0.0);
}

/// The atrium with small textures: they alone depend on their size.
#[test]
fn the_atrium_has_the_counts_that_its_readme_states() {
    let [(name, bytes), (_, sky)] = generator::atrium(32);
    assert_eq!([(name, bytes.clone()), ("atrium.exr", sky)], generator::atrium(32), "not the same every time");

    let scene = Scene::from_bytes(&bytes, Path::new(name), &ImportOptions::default()).unwrap();
    assert_eq!(scene.notes, [""; 0], "what import could not use");
    assert_eq!((scene.triangles.len(), scene.images.len()), (1_464_354, 7), "the numbers in scenes/README.md");
    assert!(scene.images.iter().all(|image| (image.width, image.height) == (32, 32)));
    let lamps = scene.lights.iter().filter(|light| matches!(light.kind, LightKind::Mesh { .. })).count();
    let suns = scene.lights.iter().filter(|light| matches!(light.kind, LightKind::Directional { .. })).count();
    assert_eq!((lamps, suns, scene.lights.len(), scene.cameras.len()), (20, 1, 21, 2));
    let masked = gltf::Gltf::from_slice(&bytes).unwrap().document;
    let masked = masked.materials().filter(|material| material.alpha_mode() == gltf::material::AlphaMode::Mask);
    assert_eq!(masked.count(), 1, "leaves");
}
