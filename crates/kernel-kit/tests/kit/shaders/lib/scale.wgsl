import package::lib::constants::SCALE;
fn scaled(value: u32) -> u32 { return value * SCALE; }
fn unused() {}
