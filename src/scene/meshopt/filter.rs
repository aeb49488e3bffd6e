//! Filters of meshopt compression (appendix B of KHR_meshopt_compression): the last step of decoding attributes.
//! Numbers outside of their valid range give some number, never a panic.

/// The encoding of decoded attributes.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Filter {
    Octahedral,
    Quaternion,
    Exponential,
    Colour,
}

impl Filter {
    /// The filter of that name; `None` for `NONE`. Colours belong to the KHR extension only.
    pub fn named(name: &str, is_khr: bool) -> Result<Option<Filter>, String> {
        match name {
            "NONE" => Ok(None),
            "OCTAHEDRAL" => Ok(Some(Filter::Octahedral)),
            "QUATERNION" => Ok(Some(Filter::Quaternion)),
            "EXPONENTIAL" => Ok(Some(Filter::Exponential)),
            "COLOR" if is_khr => Ok(Some(Filter::Colour)),
            other => Err(format!("\"{other}\" is not a filter of this extension")),
        }
    }

    /// Whether the filter exists for elements of `stride` bytes.
    pub fn fits(self, stride: usize) -> bool {
        match self {
            Filter::Octahedral | Filter::Colour => stride == 4 || stride == 8,
            Filter::Quaternion => stride == 8,
            Filter::Exponential => stride.is_multiple_of(4),
        }
    }

    /// Replaces the elements by the values that they encode.
    pub fn apply(self, bytes: &mut [u8], stride: usize) {
        let of_words = |decode: fn([i16; 4]) -> [i16; 4], bytes: &mut [u8]| {
            for element in bytes.as_chunks_mut::<8>().0 {
                let word = |i: usize| i16::from_le_bytes([element[2 * i], element[2 * i + 1]]);
                let decoded = decode([0, 1, 2, 3].map(word));
                for (to, from) in element.as_chunks_mut::<2>().0.iter_mut().zip(decoded) {
                    *to = from.to_le_bytes();
                }
            }
        };
        let of_bytes = |decode: fn([i8; 4]) -> [i8; 4], bytes: &mut [u8]| {
            for element in bytes.as_chunks_mut::<4>().0 {
                *element = decode(element.map(|byte| byte as i8)).map(|byte| byte as u8);
            }
        };
        match (self, stride) {
            (Filter::Octahedral, 4) => of_bytes(
                |[x, y, one, rest]| {
                    let [x, y, z] = octahedral([x, y, one].map(f32::from)).map(|v| (v * 127.0).round() as i8);
                    [x, y, z, rest]
                },
                bytes,
            ),
            (Filter::Octahedral, _) => of_words(
                |[x, y, one, rest]| {
                    let [x, y, z] = octahedral([x, y, one].map(f32::from)).map(|v| (v * 32767.0).round() as i16);
                    [x, y, z, rest]
                },
                bytes,
            ),
            (Filter::Quaternion, _) => of_words(quaternion, bytes),
            (Filter::Exponential, _) => {
                for word in bytes.as_chunks_mut::<4>().0 {
                    *word = exponential(i32::from_le_bytes(*word)).to_le_bytes();
                }
            }
            (Filter::Colour, 4) => of_bytes(
                |[y, co, cg, alpha]| {
                    let [y, alpha] = [y, alpha].map(|byte| i32::from(byte as u8));
                    colour([y, co.into(), cg.into(), alpha], 255.0).map(|v| v as u8 as i8)
                },
                bytes,
            ),
            (Filter::Colour, _) => of_words(
                |[y, co, cg, alpha]| {
                    let [y, alpha] = [y, alpha].map(|word| i32::from(word as u16));
                    colour([y, co.into(), cg.into(), alpha], 65535.0).map(|v| v as u16 as i16)
                },
                bytes,
            ),
        }
    }
}

/// Filter 1: the unit vector at a point of the unfolded octahedron.
fn octahedral([x, y, one]: [f32; 3]) -> [f32; 3] {
    let (x, y) = (x / one, y / one);
    let z = 1.0 - x.abs() - y.abs();
    let fold = z.min(0.0);
    let (x, y) = (x - fold.copysign(x), y - fold.copysign(y));
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// Filter 2: the quaternion whose largest component is left out.
fn quaternion([x, y, z, last]: [i16; 4]) -> [i16; 4] {
    let one = f32::from(last | 3);
    let [x, y, z] = [x, y, z].map(|v| f32::from(v) / one * std::f32::consts::FRAC_1_SQRT_2);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    let largest = (last & 3) as usize;
    let mut decoded = [0; 4];
    for (i, value) in [w, x, y, z].into_iter().enumerate() {
        decoded[(largest + i) % 4] = (value * 32767.0).round() as i16;
    }
    decoded
}

/// Filter 3: 8 bits of exponent, 24 of mantissa. The product is exact in f64, and the specification requires that of
/// f32.
fn exponential(value: i32) -> f32 {
    (f64::from(value << 8 >> 8) * 2f64.powi(value >> 24)) as f32
}

/// Filter 4: colour from luma, two chromas and alpha, all with the number of bits that alpha's highest set bit gives.
fn colour([y, co, cg, alpha]: [i32; 4], max: f32) -> [f32; 4] {
    let scale = (1 << (32 - alpha.leading_zeros())) - 1;
    let a = alpha & (scale >> 1);
    [y + co - cg, y + cg, y - co - cg, a << 1 | a & 1].map(|v| (v as f32 * max / scale as f32).round())
}
