//! Import of a .glb with a valid container. The JSON is the input up to its first zero byte, the binary chunk is the
//! rest.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let (json, bin) = (&bytes[..end], bytes.get(end + 1..).unwrap_or(&[]));
    let word = |n: usize| (n as u32).to_le_bytes();
    let length = word(12 + 8 + json.len() + 8 + bin.len());
    let glb = [b"glTF", &word(2), &length, &word(json.len()), b"JSON", json, &word(bin.len()), b"BIN\0", bin].concat();
    penumbra_fuzz::import(&glb, json, "no folder/scene.glb");
});
