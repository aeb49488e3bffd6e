//! Structs of the host and of kernels are the same, or the difference is named.

use kernel_kit::{Composer, Features, SharedStruct, check_layouts, shared_struct};

shared_struct! { struct Pair { first: f32, second: u32 } }
shared_struct! { struct Nested { pairs: [Pair; 2], last: [f32; 2] } }

fn check(structs: &str, shared: &[&SharedStruct]) -> kernel_kit::Result<()> {
    let source = format!(
        "{structs} @group(0) @binding(0) var<storage, read_write> values: array<Value>;
         @compute @workgroup_size(1) fn touch() {{ let value = values[0]; values[1] = value; }}"
    );
    check_layouts(&Composer::new().compose_source("touch", &source, &Features::none()).unwrap(), shared, &[])
}

fn pair(members: &str) -> kernel_kit::Result<()> {
    check(&format!("struct Pair {{ {members} }} alias Value = Pair;"), &[&Nested::SHARED, &Pair::SHARED])
}

/// A struct whose members differ from the host's fails by name, also when the sizes agree.
#[test]
fn swapped_members_are_found() {
    pair("first: f32, second: u32").unwrap();
    let problem = pair("second: u32, first: f32").unwrap_err().to_string();
    assert!(problem.contains("kernel touch: struct Pair: member 0 is second"), "{problem}");
    assert!(pair("first: f32, second: u32, third: u32").is_err());
    assert!(pair("first: f32").is_err());
    assert!(pair("first: f32, second: vec2u").is_err());
}

/// A struct in a struct is compared too, and one that the host does not have is named.
#[test]
fn structs_in_structs_are_compared() {
    let nested = |pair: &str, shared: &[&SharedStruct]| {
        let nested = "struct Nested { pairs: array<Pair, 2>, last: vec2f } alias Value = Nested;";
        check(&format!("struct Pair {{ {pair} }} {nested}"), shared)
    };
    nested("first: f32, second: u32", &[&Nested::SHARED, &Pair::SHARED]).unwrap();
    let problem = nested("second: u32, first: f32", &[&Nested::SHARED, &Pair::SHARED]).unwrap_err().to_string();
    assert!(problem.contains("struct Pair: member 0"), "{problem}");
    let problem = nested("first: f32, second: u32", &[&Nested::SHARED]).unwrap_err().to_string();
    assert!(problem.contains("struct Pair: has no twin"), "{problem}");
}

/// A struct that only kernels read needs no twin, only room: its size is compared.
#[test]
fn opaque_structs_are_compared_by_size() {
    let source = "struct Value { first: vec4f, second: vec4f }
         @group(0) @binding(0) var<storage, read_write> values: array<Value>;
         @compute @workgroup_size(1) fn touch() { values[1] = values[0]; }";
    let composed = Composer::new().compose_source("touch", source, &Features::none()).unwrap();
    check_layouts(&composed, &[], &[("Other", 1), ("Value", 32)]).unwrap();
    let problem = check_layouts(&composed, &[], &[("Value", 16)]).unwrap_err().to_string();
    assert!(problem.contains("struct Value: 32 bytes in the kernel, 16 on the host"), "{problem}");
}
