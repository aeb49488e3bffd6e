//! Materials, textures and samplers.

use glam::{Vec2, Vec3, Vec4};
use penumbra::Settings;
use penumbra::internal::scene::{AlphaMode, ColourSpace, Filter, Material, Scene, Wrap};
use penumbra::internal::specialisation::Specialisation;
use penumbra::internal::specialisation::features::{Feature, Features};
use serde_json::{Value, json};

use crate::bad_input::refused_at;
use crate::builder::{File, U16, png};

/// A triangle with `material` and two sets of texture coordinates, and `images` images.
fn with_material(material: Value, images: usize) -> File {
    let mut file = File::new();
    for i in 0..images {
        let view = file.view(&png(1, 1, &[[i as u8, 0, 0, 255]]));
        file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
        file.add("textures", json!({ "source": i }));
    }
    let uvs = [file.floats(&[[0f32, 0.], [1., 0.], [0., 1.]]), file.floats(&[[5f32, 6.]; 3])];
    file.add("materials", material);
    file.mesh(
        &[[0., 0., 0.], [4., 0., 0.], [0., 2., 0.]],
        json!({ "material": 0, "attributes": { "TEXCOORD_0": uvs[0], "TEXCOORD_1": uvs[1] } }),
    );
    file
}

fn material(json: Value) -> Material {
    with_material(json, 0).load().materials.swap_remove(0)
}

#[test]
fn defaults_of_the_specification() {
    let m = material(json!({}));
    assert_eq!(m.base_colour, Vec4::ONE);
    assert_eq!((m.metallic, m.roughness), (1.0, 1.0));
    assert_eq!((m.ior, m.specular.factor, m.specular.colour), (1.5, 1.0, Vec3::ONE));
    assert_eq!(m.emissive, Vec3::ZERO);
    assert_eq!((m.alpha, m.double_sided, m.unlit), (AlphaMode::Opaque, false, false));
    assert_eq!(m.name, "material 0");
    // A primitive without a material has one with these defaults too.
    let scene = File::triangle().load();
    let plain = &scene.materials[scene.triangles[0].material as usize];
    assert_eq!(Material { name: m.name.clone(), ..plain.clone() }, m);
}

#[test]
fn factors_and_extensions() {
    let m = material(json!({
        "name": "gold", "doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.25, "emissiveFactor": [1, 0.5, 0],
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.25, 0.125, 0.75], "metallicFactor": 0.5, "roughnessFactor": 0.25,
        },
        "extensions": {
            "KHR_materials_emissive_strength": { "emissiveStrength": 8 },
            "KHR_materials_ior": { "ior": 1.25 },
            "KHR_materials_specular": { "specularFactor": 0.5, "specularColorFactor": [2, 1, 0.5] },
        },
    }));
    assert_eq!(m.name, "gold");
    assert_eq!(m.base_colour, Vec4::new(0.5, 0.25, 0.125, 0.75));
    assert_eq!((m.metallic, m.roughness), (0.5, 0.25));
    assert_eq!(m.emissive, Vec3::new(8.0, 4.0, 0.0));
    assert_eq!((m.ior, m.specular.factor, m.specular.colour), (1.25, 0.5, Vec3::new(2.0, 1.0, 0.5)));
    assert_eq!((m.alpha, m.double_sided), (AlphaMode::Mask { cutoff: 0.25 }, true));
    assert_eq!(material(json!({ "alphaMode": "BLEND" })).alpha, AlphaMode::Blend);
    assert_eq!(material(json!({ "alphaMode": "MASK" })).alpha, AlphaMode::Mask { cutoff: 0.5 });
}

#[test]
fn sheen() {
    let info = |index: u32, set: u32| json!({ "index": index, "texCoord": set });
    let sheen = json!({
        "sheenColorFactor": [0.5, 0.25, 1], "sheenRoughnessFactor": 0.75,
        "sheenColorTexture": info(0, 1), "sheenRoughnessTexture": info(1, 0),
    });
    let scene = with_material(json!({ "extensions": { "KHR_materials_sheen": sheen } }), 2).load();
    let m = &scene.materials[0];
    assert!(!scene.notes.iter().any(|note| note.contains("sheen")), "{:?}", scene.notes);
    assert_eq!((m.sheen.colour, m.sheen.roughness), (Vec3::new(0.5, 0.25, 1.0), 0.75));
    let [colour, roughness] = [m.sheen.colour_texture, m.sheen.roughness_texture].map(Option::unwrap);
    let spaces = [colour, roughness].map(|info| scene.textures[info.texture as usize].space);
    assert_eq!(spaces, [ColourSpace::Srgb, ColourSpace::Linear]);
    assert_eq!((colour.uv_set, roughness.uv_set), (1, 0));
    // Without a colour there is no sheen.
    let none = material(json!({ "extensions": { "KHR_materials_sheen": {} } }));
    assert_eq!((none.sheen.colour, none.sheen.roughness), (Vec3::ZERO, 0.0));
}

#[test]
fn iridescence() {
    let info = |index: u32, set: u32| json!({ "index": index, "texCoord": set });
    let scene = |film: Value| with_material(json!({ "extensions": { "KHR_materials_iridescence": film } }), 2).load();
    let textured = scene(json!({
        "iridescenceFactor": 0.5, "iridescenceIor": 1.8, "iridescenceThicknessMinimum": 200,
        "iridescenceThicknessMaximum": 550, "iridescenceTexture": info(0, 1), "iridescenceThicknessTexture": info(1, 0),
    }));
    let film = textured.materials[0].iridescence;
    assert!(!textured.notes.iter().any(|note| note.contains("iridescence")), "{:?}", textured.notes);
    assert_eq!((film.factor, film.ior), (0.5, 1.8));
    assert_eq!((film.thickness_minimum, film.thickness_maximum), (200.0, 550.0));
    let infos = [film.texture, film.thickness_texture].map(Option::unwrap);
    assert_eq!(infos.map(|info| info.uv_set), [1, 0]);
    assert_eq!(infos.map(|info| textured.textures[info.texture as usize].space), [ColourSpace::Linear; 2]);
    // The extension's defaults, which are no film.
    let none = scene(json!({})).materials.swap_remove(0).iridescence;
    assert_eq!((none.factor, none.ior, none.thickness_minimum, none.thickness_maximum), (0.0, 1.3, 100.0, 400.0));

    // Kernels have it where a film is seen.
    let has = |scene: &Scene| Specialisation::new(scene, None, &Settings::default()).features.has(Feature::Iridescence);
    assert!(has(&textured) && has(&scene(json!({ "iridescenceFactor": 1 }))));
    assert!(!has(&scene(json!({}))) && !has(&File::triangle().load()));
    assert!(!has(&scene(json!({ "iridescenceFactor": 1, "iridescenceThicknessMaximum": 0 }))));
    let both = json!({ "KHR_materials_unlit": {}, "KHR_materials_iridescence": { "iridescenceFactor": 1 } });
    assert!(!has(&with_material(json!({ "extensions": both }), 0).load()));
    // A Lambertian under a film is none: the film reflects.
    let lambertian = json!({
        "pbrMetallicRoughness": { "metallicFactor": 0 },
        "extensions": {
            "KHR_materials_specular": { "specularFactor": 0 },
            "KHR_materials_iridescence": { "iridescenceFactor": 1 },
        },
    });
    let features = Specialisation::new(&with_material(lambertian, 0).load(), None, &Settings::default()).features;
    assert!(features.has(Feature::Glossy) && features.has(Feature::Iridescence));
}

/// A high index of refraction makes a mirror only of a surface that reflects specularly.
#[test]
fn dense_lambertians_are_no_mirrors() {
    let features = |specular: f64| {
        let dense = json!({
            // A light, without which nothing is seen.
            "emissiveFactor": [1, 1, 1],
            "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0 },
            "extensions": {
                "KHR_materials_ior": { "ior": 3 },
                "KHR_materials_specular": { "specularFactor": specular },
            },
        });
        Specialisation::new(&with_material(dense, 0).load(), None, &Settings::default()).features
    };
    let decided = |features: Features| [Feature::Glossy, Feature::SpecularChains].map(|feature| features.has(feature));
    assert_eq!(decided(features(1.0)), [true; 2]);
    assert_eq!(decided(features(0.0)), [false; 2]);
}

/// All textures of a coat are read. A coat has a normal on the device only if it differs from that of its base.
#[test]
fn clear_coats() {
    let info = |index: u32, set: u32| json!({ "index": index, "texCoord": set });
    let coated = |coat: Value, base: Value| {
        with_material(json!({ "normalTexture": base, "extensions": { "KHR_materials_clearcoat": coat } }), 3).load()
    };
    let mapped = |scale: f64| json!({ "index": 2, "scale": scale });
    let scene = coated(
        json!({
            "clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25, "clearcoatTexture": info(0, 1),
            "clearcoatRoughnessTexture": info(1, 0), "clearcoatNormalTexture": mapped(0.75),
        }),
        info(0, 0),
    );
    let m = &scene.materials[0];
    assert!(!scene.notes.iter().any(|note| note.contains("coat")), "{:?}", scene.notes);
    assert_eq!((m.clearcoat.factor, m.clearcoat.roughness, m.clearcoat.normal_scale), (0.5, 0.25, 0.75));
    let coat = &m.clearcoat;
    let infos = [coat.texture, coat.roughness_texture, coat.normal_texture].map(Option::unwrap);
    assert_eq!(infos.map(|info| info.uv_set), [1, 0, 0]);
    assert!(infos.iter().all(|info| scene.textures[info.texture as usize].space == ColourSpace::Linear));

    let has_own = |coat: Value, base: Value| {
        Specialisation::new(&coated(coat, base), None, &Settings::default()).features.has(Feature::CoatNormals)
    };
    let coat = |normal: Value| json!({ "clearcoatFactor": 1, "clearcoatNormalTexture": normal });
    assert!(has_own(coat(mapped(1.0)), info(0, 0)));
    assert!(has_own(coat(mapped(0.5)), mapped(1.0)));
    // A coat without a map is smooth over a base that has one (KHR_materials_clearcoat).
    assert!(has_own(json!({ "clearcoatFactor": 1 }), mapped(1.0)));
    assert!(!has_own(coat(mapped(1.0)), mapped(1.0)));
    assert!(!has_own(json!({}), mapped(1.0)));
}

#[test]
fn unlit_materials_emit_nothing() {
    let scene =
        with_material(json!({ "emissiveFactor": [1, 1, 1], "extensions": { "KHR_materials_unlit": {} } }), 0).load();
    assert!(scene.materials[0].unlit && scene.lights.is_empty());
    assert_eq!(scene.materials[0].emissive, Vec3::ZERO);
}

#[test]
fn every_texture_has_its_colour_space_and_coordinates() {
    let info = |index: u32, set: u32| json!({ "index": index, "texCoord": set });
    let scene = with_material(
        json!({
            "pbrMetallicRoughness": { "baseColorTexture": info(0, 0), "metallicRoughnessTexture": info(1, 1) },
            "normalTexture": { "index": 2, "scale": 0.5 },
            "occlusionTexture": info(5, 1),
            "emissiveTexture": info(3, 0),
            "extensions": {
                "KHR_materials_specular": { "specularTexture": info(0, 0), "specularColorTexture": info(4, 1) },
            },
        }),
        6,
    )
    .load();
    let m = &scene.materials[0];
    // Image (its red value is its number), texture coordinate set and colour space.
    let read = |info: Option<penumbra::internal::scene::TextureInfo>| {
        let info = info.unwrap();
        let texture = scene.textures[info.texture as usize];
        (scene.images[texture.image as usize].texels[0][0], info.uv_set, texture.space)
    };
    use ColourSpace::{Linear, Srgb};
    assert_eq!(read(m.base_colour_texture), (0, 0, Srgb));
    assert_eq!(read(m.metallic_roughness_texture), (1, 1, Linear));
    assert_eq!(read(m.normal_texture), (2, 0, Linear));
    assert_eq!(read(m.emissive_texture), (3, 0, Srgb));
    assert_eq!(read(m.specular.texture), (0, 0, Linear));
    assert_eq!(read(m.specular.colour_texture), (4, 1, Srgb));
    assert_eq!(m.normal_scale, 0.5);
    // Image 0 is used as colour and as linear data, but decoded once; that of the occlusion texture is not.
    assert_eq!((scene.textures.len(), scene.images.len()), (6, 5));
    assert_eq!(scene.vertices[0].uv, [Vec2::ZERO, Vec2::new(5.0, 6.0)]);
}

#[test]
fn samplers_wrap_and_filter() {
    let texture = |sampler: Option<Value>| {
        let mut file = with_material(json!({ "normalTexture": { "index": 0 } }), 1);
        if let Some(sampler) = sampler {
            file.json["samplers"] = json!([sampler]);
            file.json["textures"][0]["sampler"] = json!(0);
        }
        file.load().textures[0]
    };
    let t = texture(None);
    assert_eq!((t.wrap, t.filter), ([Wrap::Repeat; 2], Filter::Linear));
    let t = texture(Some(json!({ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9987 })));
    assert_eq!((t.wrap, t.filter), ([Wrap::Clamp, Wrap::Mirror], Filter::Nearest));
    let t = texture(Some(json!({ "magFilter": 9729 })));
    assert_eq!((t.wrap, t.filter), ([Wrap::Repeat; 2], Filter::Linear));
}

#[test]
fn texture_transform_scales_rotates_and_translates() {
    let info = |transform: Value| {
        let texture = json!({ "index": 0, "texCoord": 0, "extensions": { "KHR_texture_transform": transform } });
        let scene = with_material(json!({ "normalTexture": texture }), 1).load();
        scene.materials[0].normal_texture.unwrap()
    };
    // Products of f32 cosines and numbers up to 4: half of a unit in the last place of 4 is 2.4e-7.
    let close = |a: Vec2, b: Vec2| assert!((a - b).length() < 1e-6, "{a} for {b}");
    let s = info(json!({ "offset": [0.5, 0.25], "scale": [2, 4], "texCoord": 1 }));
    assert_eq!(s.uv_set, 1);
    close(s.matrix * Vec2::new(1.0, 1.0) + s.offset, Vec2::new(2.5, 4.25));
    // Counter-clockwise with v down: 90 degrees map +u to -v and +v to +u. The scale is applied first.
    let s = info(json!({ "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 4] }));
    assert_eq!(s.uv_set, 0);
    close(s.matrix * Vec2::X, Vec2::new(0.0, -2.0));
    close(s.matrix * Vec2::Y, Vec2::new(4.0, 0.0));
}

#[test]
fn vertex_colours_of_three_and_four_components() {
    let colours = |file: &File| -> Vec<Vec4> { file.load().vertices.iter().map(|v| v.colour).collect() };
    let mut file = File::triangle();
    assert_eq!(colours(&file), [Vec4::ONE; 3]);
    let rgb = file.floats(&[[0.5f32, 0.25, 0.125]; 3]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(rgb);
    assert_eq!(colours(&file), [Vec4::new(0.5, 0.25, 0.125, 1.0); 3]);
    let bytes: Vec<u8> = [65535u16, 0, 13107, 26214].iter().flat_map(|x| x.to_le_bytes()).collect();
    let rgba = file.accessor(&bytes.repeat(3), U16, "VEC4", 3);
    file.json["accessors"][rgba]["normalized"] = json!(true);
    file.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(rgba);
    assert_eq!(colours(&file), [Vec4::new(1.0, 0.0, 0.2, 0.4); 3]);
}

/// A lamp whose texture cannot be shown emits nothing: without it, all of the surface would be a lamp.
#[test]
fn lamps_without_their_texture_are_dark() {
    let emits = |texture: serde_json::Value| {
        let mut file = with_material(json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": texture }), 1);
        // A source of a format that is not read.
        file.add("textures", json!({ "extensions": { "EXT_texture_avif": { "source": 0 } } }));
        file.load().materials[0].emissive != Vec3::ZERO
    };
    assert!(emits(json!({ "index": 0 })));
    assert!(!emits(json!({ "index": 0, "texCoord": 2 })));
    assert!(!emits(json!({ "index": 1 })));
}

#[test]
fn images_from_files_and_data_uris() {
    let path = crate::builder::temporary("gltf");
    let folder = path.parent().unwrap().join("a folder");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("red.png"), png(1, 1, &[[255, 0, 0, 255]])).unwrap();
    let mut file = with_material(json!({ "emissiveTexture": { "index": 0 }, "normalTexture": { "index": 1 } }), 2);
    std::fs::write(folder.join("all.bin"), &file.bin).unwrap();
    file.json["buffers"] = json!([{ "uri": "./a%20folder/all.bin", "byteLength": file.bin.len() }]);
    // A 1 x 1 PNG with the texel (0, 0, 255), written by another program.
    let blue = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGNgYPgPAAEDAQAIicLsAAAAAElFTkSuQmCC";
    file.json["images"] = json!([
        { "uri": "x/../a%20folder/red.png" },
        { "uri": format!("data:image/png;base64,{blue}"), "name": "blue" }
    ]);
    std::fs::write(&path, file.json.to_string()).unwrap();
    let scene = Scene::load(&path, &Default::default()).unwrap();
    let image = |name: &str| scene.images.iter().find(|i| i.name == name).unwrap().texels.clone();
    assert_eq!(image("x/../a%20folder/red.png"), [[255, 0, 0, 255]]);
    assert_eq!(image("blue"), [[0, 0, 255, 255]]);
}

/// Specular and glossiness become a dielectric of infinite index; their texture becomes two.
#[test]
fn specular_and_glossiness() {
    const NAME: &str = "KHR_materials_pbrSpecularGlossiness";
    let of = |json: Value, images: usize| {
        let mut base = json!({ "baseColorFactor": [1, 0, 0, 1], "roughnessFactor": 0.1 });
        if images > 0 {
            // Not read: the extension takes its place.
            base["baseColorTexture"] = json!({ "index": images });
        }
        with_material(json!({ "pbrMetallicRoughness": base, "extensions": { NAME: json } }), images + 1)
    };
    let plain = of(
        json!({
            "diffuseFactor": [0.5, 0.25, 1, 0.75], "specularFactor": [0.5, 0.25, 0.125], "glossinessFactor": 0.75,
        }),
        0,
    );
    let scene = plain.load();
    let m = &scene.materials[0];
    assert_eq!(m.base_colour, Vec4::new(0.25, 0.125, 0.5, 0.75));
    assert_eq!((m.metallic, m.roughness, m.ior), (0.0, 0.25, 0.0));
    assert_eq!((m.specular.factor, m.specular.colour), (1.0, Vec3::new(0.5, 0.25, 0.125)));
    assert!(m.texture_infos().next().is_none());
    assert!(!scene.notes.iter().any(|note| note.contains("Glossiness")), "{:?}", scene.notes);
    // The defaults: a smooth white mirror.
    let m = of(json!({}), 0).load().materials.swap_remove(0);
    assert_eq!((m.base_colour, m.roughness, m.specular.colour), (Vec4::new(0.0, 0.0, 0.0, 1.0), 0.0, Vec3::ONE));

    let textured = json!({
        "diffuseTexture": { "index": 0 }, "specularGlossinessTexture": { "index": 1, "texCoord": 1 },
        "glossinessFactor": 0.5,
    });
    let mut file = of(textured, 2);
    let view = file.view(&png(2, 1, &[[10, 20, 30, 255], [40, 50, 60, 100]]));
    file.json["images"][1]["bufferView"] = json!(view);
    let scene = file.load();
    let m = &scene.materials[0];
    let image = |info: Option<penumbra::internal::scene::TextureInfo>| {
        let texture = &scene.textures[info.unwrap().texture as usize];
        (texture.space, info.unwrap().uv_set, &scene.images[texture.image as usize].texels)
    };
    assert_eq!((m.base_colour, m.metallic, m.roughness), (Vec4::ONE, 0.0, 1.0));
    assert_eq!(image(m.base_colour_texture), (ColourSpace::Srgb, 0, &vec![[0, 0, 0, 255]]));
    let stored = vec![[10, 20, 30, 255], [40, 50, 60, 100]];
    assert_eq!(image(m.specular.colour_texture), (ColourSpace::Srgb, 1, &stored));
    let (space, set, texels) = image(m.metallic_roughness_texture);
    // 255 - 127.5 and 255 - 50, rounded.
    assert_eq!((space, set, texels[0][1], texels[1][1]), (ColourSpace::Linear, 1, 127, 205));
    assert_eq!(scene.images.len(), 3);

    for (key, bad) in
        [("diffuseFactor", json!([2, 0, 0, 1])), ("glossinessFactor", json!(-1)), ("specularFactor", json!([1, 1]))]
    {
        let error = of(json!({ key: bad }), 0).load_with(&Default::default()).unwrap_err().to_string();
        assert!(error.contains(&format!("/materials/0/extensions/{NAME}/{key}")), "{error}");
    }
}

/// Leaves and prisms: all parameters, and the features of kernels that need them.
#[test]
fn diffuse_transmission_and_dispersion() {
    let info = |index: u32| json!({ "index": index });
    let of = |extensions: Value, images: usize| with_material(json!({ "extensions": extensions }), images).load();
    let features = |scene: &Scene| Specialisation::new(scene, None, &Settings::default()).features;
    let leaf = of(
        json!({ "KHR_materials_diffuse_transmission": {
            "diffuseTransmissionFactor": 0.5, "diffuseTransmissionColorFactor": [0.25, 0.5, 0.75],
            "diffuseTransmissionTexture": info(0), "diffuseTransmissionColorTexture": info(1),
        } }),
        2,
    );
    assert!(!leaf.notes.iter().any(|note| note.contains("diffuse")), "{:?}", leaf.notes);
    let lobe = leaf.materials[0].diffuse_transmission;
    assert_eq!((lobe.factor, lobe.colour), (0.5, Vec3::new(0.25, 0.5, 0.75)));
    let spaces = [lobe.texture, lobe.colour_texture].map(|info| leaf.textures[info.unwrap().texture as usize].space);
    assert_eq!(spaces, [ColourSpace::Linear, ColourSpace::Srgb]);
    assert!(features(&leaf).has(Feature::DiffuseTransmission) && features(&leaf).has(Feature::Transmission));
    let opaque = of(json!({ "KHR_materials_diffuse_transmission": {} }), 0);
    assert!(!features(&opaque).has(Feature::DiffuseTransmission) && !features(&opaque).has(Feature::Transmission));

    let prism = |thickness: f64, transmission: f64| {
        of(
            json!({
                "KHR_materials_dispersion": { "dispersion": 0.5 },
                "KHR_materials_transmission": { "transmissionFactor": transmission },
                "KHR_materials_volume": { "thicknessFactor": thickness },
            }),
            0,
        )
    };
    assert_eq!(prism(1.0, 1.0).materials[0].dispersion.strength, 0.5);
    assert!(features(&prism(1.0, 1.0)).has(Feature::Dispersion));
    // A thin wall does not refract, and what is opaque neither.
    assert!(!features(&prism(0.0, 1.0)).has(Feature::Dispersion));
    assert!(!features(&prism(1.0, 0.0)).has(Feature::Dispersion));
    for (extension, key, value) in [
        ("KHR_materials_diffuse_transmission", "diffuseTransmissionFactor", json!(1.5)),
        ("KHR_materials_diffuse_transmission", "diffuseTransmissionColorFactor", json!([0, 0, -1])),
        ("KHR_materials_dispersion", "dispersion", json!(-1)),
    ] {
        let file = with_material(json!({ "extensions": { extension: { key: value } } }), 0);
        assert!(refused_at(&file).starts_with(&format!("/materials/0/extensions/{extension}/{key}")));
    }
}

/// A volume whose surface rays may pass by its alpha is not absorbed right, and the import says so.
#[test]
fn volumes_with_alpha_are_noted() {
    let notes_of = |material: Value, alpha: f32| {
        let mut material = material;
        material["name"] = json!("jelly");
        material["extensions"] = json!({
            "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": { "thicknessFactor": 1 },
        });
        let mut file = with_material(material, 1);
        let colours = file.floats(&[[1f32, 1., 1., alpha]; 3]);
        file.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colours);
        let scene = file.load();
        scene.notes.iter().filter(|note| note.starts_with("material \"jelly\" has a volume")).count()
    };
    let notes = |material: Value| notes_of(material, 1.0);
    let factor = |alpha: f64| json!({ "baseColorFactor": [1, 1, 1, alpha] });
    let texture = || json!({ "baseColorTexture": { "index": 0 } });
    assert_eq!(notes(json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": factor(0.5) })), 1);
    assert_eq!(notes(json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": factor(1.0) })), 0);
    assert_eq!(notes(json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": texture() })), 1);
    assert_eq!(notes(json!({ "alphaMode": "MASK", "pbrMetallicRoughness": texture() })), 1);
    assert_eq!(notes(json!({ "alphaMode": "MASK", "pbrMetallicRoughness": factor(0.6) })), 0);
    assert_eq!(notes(json!({ "alphaMode": "OPAQUE", "pbrMetallicRoughness": factor(0.5) })), 0);
    assert_eq!(["BLEND", "OPAQUE"].map(|mode| notes_of(json!({ "alphaMode": mode }), 0.5)), [1, 0]);
}

/// The corners of a cube with the given centre and half of its side, as triangles of three positions each.
fn cube(centre: [f32; 3], half: f32) -> Vec<[f32; 3]> {
    const QUADS: [[usize; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let side = |i: usize, axis: usize| if i >> axis & 1 == 1 { half } else { -half };
    let corner = |i: usize| [0, 1, 2].map(|axis| centre[axis] + side(i, axis));
    QUADS.iter().flat_map(|[a, b, c, d]| [*a, *b, *c, *a, *c, *d]).map(corner).collect()
}

/// A primitive lies in the smallest closed volume that encloses it.
#[test]
fn volumes_within_volumes() {
    let volume = |thickness: f64, ior: f64| {
        json!({ "extensions": {
            "KHR_materials_ior": { "ior": ior },
            "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": {
                "thicknessFactor": thickness, "attenuationDistance": 2, "attenuationColor": [0.5, 0.5, 0.5],
            },
        } })
    };
    let load = |tank: Value, inner: &[(&str, [f32; 3], f32, usize)]| {
        let mut file = File::new();
        for material in [tank, volume(1.0, 1.5), json!({}), json!({ "emissiveFactor": [1, 1, 1] })] {
            file.add("materials", material);
        }
        file.mesh(&cube([0.0; 3], 4.0), json!({ "material": 0 }));
        for (_, centre, half, material) in inner {
            file.mesh(&cube(*centre, *half), json!({ "material": material }));
        }
        file.load()
    };
    let index = |scene: &Scene, cube: usize| {
        let material = &scene.materials[scene.triangles[12 * cube].material as usize];
        material.medium.map(|medium| medium.ior)
    };
    let water = || volume(1.0, 1.25);
    let inner = [
        ("glass in water", [1.0, 1.0, 1.0], 1.5, 1),
        ("stone in the glass", [1.0, 1.0, 1.0], 0.5, 2),
        ("stone in water", [-2.0, 0.0, 0.0], 0.5, 2),
        ("stone beside the tank", [8.0, 0.0, 0.0], 0.5, 2),
        ("stone half out of the water", [4.0, 0.0, 0.0], 0.5, 2),
        ("lamp in water", [-2.0, 2.0, 0.0], 0.5, 3),
    ];
    let scene = load(water(), &inner);
    let expected = [None, Some(1.25), Some(1.5), Some(1.25), None, None, None];
    for (cube, expected) in expected.into_iter().enumerate() {
        assert_eq!(index(&scene, cube), expected, "cube {cube}");
    }
    let features = |scene: &Scene| Specialisation::new(scene, None, &Settings::default()).features;
    assert!(features(&scene).has(Feature::Immersed));
    assert!(!features(&load(water(), &inner[3..4])).has(Feature::Immersed));
    // A stone that is half a cube's width in the water, and in the box around a round volume of eight faces.
    let octahedron = |half: f32| {
        let corner = |i: usize, sign: f32| [0, 1, 2].map(|axis| if axis == i { sign * half } else { 0.0 });
        let faces = (0..8).map(|i| [0, 1, 2].map(|axis| corner(axis, if i >> axis & 1 == 1 { 1.0 } else { -1.0 })));
        let outwards =
            faces.enumerate().map(|(i, [a, b, c])| if i.count_ones() % 2 == 1 { [a, b, c] } else { [a, c, b] });
        outwards.flatten().collect::<Vec<_>>()
    };
    let mut round = File::new();
    round.add("materials", water());
    round.add("materials", json!({}));
    round.mesh(&octahedron(4.0), json!({ "material": 0 }));
    for centre in [[0.0; 3], [1.6, 1.6, 0.0]] {
        round.mesh(&cube(centre, 0.5), json!({ "material": 1 }));
    }
    let round = round.load();
    let medium = |first: usize| round.materials[round.triangles[first].material as usize].medium;
    assert_eq!([8, 20].map(|first| medium(first).is_some()), [true, false]);
    // An object that stands on the floor of the volume is in it.
    assert_eq!(index(&load(water(), &[("stone", [0.0, -3.5, 0.0], 0.5, 2)]), 1), Some(1.25));
    // A thin wall encloses no volume; an open one neither, wherever its box is.
    assert_eq!(index(&load(volume(0.0, 1.25), &inner), 1), None);
    let mut open = File::new();
    open.add("materials", water());
    open.add("materials", json!({}));
    open.mesh(&cube([0.0; 3], 4.0)[..6], json!({ "material": 0 }));
    open.mesh(&cube([0.0, 0.0, -4.0], 0.0), json!({ "material": 1 }));
    assert!(open.load().materials.iter().all(|material| material.medium.is_none()));
}

/// The inner wall of hollow glass is a primitive of its own, whose normals point into the hollow. Air is there, also
/// around a stone. A stone between the walls lies in glass.
#[test]
fn hollow_volumes_enclose_air() {
    let glass = json!({ "extensions": {
        "KHR_materials_transmission": { "transmissionFactor": 1 },
        "KHR_materials_volume": { "thicknessFactor": 1 },
    } });
    let media = |turned: bool| {
        let mut file = File::new();
        file.add("materials", glass.clone());
        file.add("materials", json!({}));
        file.mesh(&cube([0.0; 3], 4.0), json!({ "material": 0 }));
        let mut wall = cube([1.0, 0.0, 0.0], 2.0);
        if turned {
            wall.chunks_exact_mut(3).for_each(|corners| corners.swap(1, 2));
        }
        file.mesh(&wall, json!({ "material": 0 }));
        for x in [1.0, -2.5] {
            file.mesh(&cube([x, 0.0, 0.0], 0.5), json!({ "material": 1 }));
        }
        let scene = file.load();
        [0, 1, 2, 3].map(|cube| scene.materials[scene.triangles[12 * cube].material as usize].medium.is_some())
    };
    assert_eq!(media(true), [false, false, false, true]);
    assert_eq!(media(false), [false, true, true, true]);
}

/// Among many volumes, each primitive finds its own: stones lie in every other one of 216 drops, and beside the others.
#[test]
fn stones_lie_in_their_own_drops() {
    let mut file = File::new();
    let stone = file.add("materials", json!({}));
    let ior = |drop: usize| 1.25 + drop as f32 / 256.0;
    for drop in 0..216 {
        let glass = json!({ "extensions": {
            "KHR_materials_ior": { "ior": ior(drop) },
            "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": { "thicknessFactor": 1 },
        } });
        let glass = file.add("materials", glass);
        let centre = [drop % 6, drop / 6 % 6, drop / 36].map(|i| 3.0 * i as f32);
        file.mesh(&cube(centre, 1.0), json!({ "material": glass }));
        let beside = if drop % 2 == 0 { 0.0 } else { 1.5 };
        file.mesh(&cube([centre[0] + beside, centre[1], centre[2]], 0.25), json!({ "material": stone }));
    }
    let scene = file.load();
    for drop in 0..216 {
        let material = &scene.materials[scene.triangles[24 * drop + 12].material as usize];
        let expected = if drop % 2 == 0 { Some(ior(drop)) } else { None };
        assert_eq!(material.medium.map(|medium| medium.ior), expected, "drop {drop}");
    }
}

/// More texels than devices take: the largest image has half of its width and height, and a note says so. Beyond 2^31
/// texels a file is refused before anything is decoded.
#[test]
fn images_with_too_many_texels_are_reduced() {
    const SIDE: u32 = 16384;
    // One bit a texel: the left half is white.
    let row: Vec<u8> = (0..SIDE / 8).map(|byte| if byte < SIDE / 16 { 255 } else { 0 }).collect();
    let mut large = Vec::new();
    let mut encoder = png::Encoder::new(&mut large, SIDE, SIDE);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::One);
    encoder.write_header().unwrap().write_image_data(&row.repeat(SIDE as usize)).unwrap();
    let of_images = |count: usize| {
        let mut file = File::triangle();
        let coordinates = file.floats(&[[0f32, 0.]; 3]);
        file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(coordinates);
        for i in 0..count {
            let view = if i == 0 { file.view(&crate::builder::png(1, 1, &[[7; 4]])) } else { file.view(&large) };
            file.add("images", json!({ "bufferView": view }));
            file.add("textures", json!({ "source": i }));
            file.add("materials", json!({ "emissiveTexture": { "index": i } }));
        }
        file
    };
    let scene = of_images(2).load();
    let sizes: Vec<_> = scene.images.iter().map(|image| [image.width, image.height]).collect();
    assert_eq!(sizes, [[1, 1], [SIDE / 2; 2]]);
    let (white, black) = scene.images[1].texels[..SIDE as usize / 2].split_at(SIDE as usize / 4);
    assert!(white.iter().all(|texel| *texel == [255; 4]) && black.iter().all(|texel| *texel == [0, 0, 0, 255]));
    let note = "268435457 texels in total, more than 268435456: 1 of 2 is reduced, by a factor of up to 2 in width";
    assert!(scene.notes.iter().any(|line| line.contains(note)), "{:?}", scene.notes);
    // 2^31 texels are eight of them.
    assert_eq!(refused_at(&of_images(9)), "/images/8");
}
