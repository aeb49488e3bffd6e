//! Import of a file as it is: .gltf with data URIs, or .glb.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| penumbra_fuzz::import(bytes, bytes, "no folder/scene.gltf"));
