//! Import of the input as a .gltf with data URIs or a .glb.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| penumbra_fuzz::import(bytes, bytes, "no folder/scene.gltf"));
