//! The three bitstreams of meshopt compression (appendix A of KHR_meshopt_compression). All memory grows with what has
//! been decoded, because counts are mere claims.

type Result<T> = std::result::Result<T, &'static str>;

const ENDS_EARLY: &str = "the stream ends early";
const LEFT_OVER: &str = "bytes are left over";

/// Deltas that are decoded together.
const GROUP: usize = 16;

/// Bytes that have not been read.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(ENDS_EARLY)?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8> {
        Ok(self.take(1)?[0])
    }

    /// An unsigned LEB128 number of one to five bytes; bits beyond the 32nd are ignored.
    fn varint(&mut self) -> Result<u32> {
        let mut value = 0;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("a number has more than five bytes")
    }

    fn finish(self) -> Result<()> {
        if self.0.is_empty() { Ok(()) } else { Err(LEFT_OVER) }
    }
}

/// The stream without its header and its tail of `tail` bytes, and the tail.
fn parts(stream: &[u8], tail: usize) -> Result<(Reader<'_>, &[u8])> {
    let body = stream.get(1..).ok_or(ENDS_EARLY)?;
    let (body, tail) = body.split_at_checked(body.len().wrapping_sub(tail)).ok_or(ENDS_EARLY)?;
    Ok((Reader(body), tail))
}

/// Mode 0: `count` elements of `stride` bytes.
pub(super) fn attributes(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>> {
    // Version, and the size to which the tail is padded.
    let (is_v1, min_tail) = match stream.first() {
        Some(0xa0) => (false, 32),
        Some(0xa1) => (true, 24),
        _ => return Err("unknown version of the attributes"),
    };
    let channels = if is_v1 { stride / 4 } else { 0 };
    let (mut body, tail) = parts(stream, min_tail.max(stride + channels))?;
    let (baseline, modes) = tail[tail.len() - stride - channels..].split_at(stride);
    let transforms = (0..stride / 4).map(|channel| match modes.get(channel) {
        None | Some(0) => Ok(Transform::Bytes),
        Some(1) => Ok(Transform::Words),
        Some(mode) if mode & 15 == 2 => Ok(Transform::Xor(u32::from(mode >> 4))),
        Some(_) => Err("unknown mode of a channel"),
    });
    let transforms = transforms.collect::<Result<Vec<_>>>()?;

    // The format's blocks: as many elements as 8 KiB hold, but at most 256.
    let max_block = ((8192 / stride) & !(GROUP - 1)).min(256);
    let mut last = baseline.to_vec();
    let mut decoded = Vec::new();
    let mut deltas = [[0; 256]; 4];
    while decoded.len() < count * stride {
        let first = decoded.len();
        let block = max_block.min(count - first / stride);
        let controls = body.take(channels)?;
        decoded.resize(first + block * stride, 0);
        for (channel, transform) in transforms.iter().enumerate() {
            for (byte, deltas) in deltas.iter_mut().enumerate() {
                let bits = match controls.get(channel).map(|control| control >> (2 * byte) & 3) {
                    None => [0, 2, 4, 8],
                    Some(0) => [0, 1, 2, 4],
                    Some(1) => [1, 2, 4, 8],
                    Some(2) => {
                        deltas.fill(0);
                        continue;
                    }
                    Some(_) => {
                        deltas[..block].copy_from_slice(body.take(block)?);
                        continue;
                    }
                };
                data_block(&mut body, bits, &mut deltas[..block.next_multiple_of(GROUP)])?;
            }
            let mut previous = u32_at(&last, 4 * channel);
            for (i, element) in decoded[first..].chunks_exact_mut(stride).enumerate() {
                previous = transform.next(previous, [0, 1, 2, 3].map(|byte| deltas[byte][i]));
                element[4 * channel..][..4].copy_from_slice(&previous.to_le_bytes());
            }
        }
        last.copy_from_slice(&decoded[decoded.len() - stride..]);
    }
    body.finish()?;
    Ok(decoded)
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// The deltas of one byte of all elements of a block. Two bits select the number of bits of each group from `bits`.
fn data_block(body: &mut Reader, bits: [usize; 4], deltas: &mut [u8]) -> Result<()> {
    let header = body.take((deltas.len() / GROUP).div_ceil(4))?;
    for (g, group) in deltas.chunks_exact_mut(GROUP).enumerate() {
        let bits = bits[usize::from(header[g / 4] >> (2 * (g % 4)) & 3)];
        match bits {
            0 => group.fill(0),
            8 => group.copy_from_slice(body.take(GROUP)?),
            _ => {
                let packed = body.take(GROUP * bits / 8)?;
                let sentinel = ((1u16 << bits) - 1) as u8;
                for (i, delta) in group.iter_mut().enumerate() {
                    let at = i * bits;
                    // Single bits are stored from the lowest, pairs and nibbles from the highest.
                    let shift = if bits == 1 { at % 8 } else { 8 - bits - at % 8 };
                    *delta = packed[at / 8] >> shift & sentinel;
                    if *delta == sentinel {
                        *delta = body.byte()?;
                    }
                }
            }
        }
    }
    Ok(())
}

/// How the four bytes of a channel follow from those of the element before.
enum Transform {
    Bytes,
    Words,
    /// Rotation of the difference, to the left as it is stored.
    Xor(u32),
}

impl Transform {
    fn next(&self, previous: u32, deltas: [u8; 4]) -> u32 {
        match self {
            Transform::Bytes => {
                let bytes = previous.to_le_bytes();
                u32::from_le_bytes([0, 1, 2, 3].map(|i| {
                    let delta = deltas[i];
                    bytes[i].wrapping_add(if delta & 1 == 1 { !(delta >> 1) } else { delta >> 1 })
                }))
            }
            Transform::Words => {
                let word = |previous: u32, low: u8, high: u8| {
                    let delta = u16::from_le_bytes([low, high]);
                    (previous as u16).wrapping_add(if delta & 1 == 1 { !(delta >> 1) } else { delta >> 1 })
                };
                let low = word(previous, deltas[0], deltas[1]);
                u32::from(low) | u32::from(word(previous >> 16, deltas[2], deltas[3])) << 16
            }
            Transform::Xor(rotation) => previous ^ u32::from_le_bytes(deltas).rotate_right(*rotation),
        }
    }
}

/// The last 16 values that were pushed.
struct Fifo<T> {
    values: [T; 16],
    pushed: usize,
}

impl<T: Copy + Default> Fifo<T> {
    fn new() -> Self {
        Fifo { values: [T::default(); 16], pushed: 0 }
    }

    fn push(&mut self, value: T) {
        self.values[self.pushed % 16] = value;
        self.pushed += 1;
    }

    /// The value pushed `age` values before the last one.
    fn get(&self, age: usize) -> Result<T> {
        if age < self.pushed.min(16) {
            Ok(self.values[(self.pushed - 1 - age) % 16])
        } else {
            Err("a triangle refers to a vertex or edge that was never stored")
        }
    }
}

fn zigzag(value: u32) -> u32 {
    if value & 1 == 1 { !(value >> 1) } else { value >> 1 }
}

fn emit(decoded: &mut Vec<u8>, index: u32, stride: usize) {
    decoded.extend_from_slice(&index.to_le_bytes()[..stride]);
}

/// State of the decoder of triangles.
struct Triangles<'a> {
    data: Reader<'a>,
    /// The index that is expected to occur next for the first time.
    next: u32,
    /// The last index that was stored explicitly.
    last: u32,
    edges: Fifo<[u32; 2]>,
    vertices: Fifo<u32>,
}

impl Triangles<'_> {
    fn take_next(&mut self) -> u32 {
        let index = self.next;
        self.next = self.next.wrapping_add(1);
        index
    }

    fn explicit(&mut self) -> Result<u32> {
        self.last = self.last.wrapping_add(zigzag(self.data.varint()?));
        Ok(self.last)
    }

    /// The triangle on a stored edge.
    fn on_edge(&mut self, edge: usize, third: usize) -> Result<[u32; 3]> {
        let [a, b] = self.edges.get(edge)?;
        let c = match third {
            0 => self.take_next(),
            1..=12 => self.vertices.get(third)?,
            13 => {
                self.last = self.last.wrapping_sub(1);
                self.last
            }
            14 => {
                self.last = self.last.wrapping_add(1);
                self.last
            }
            _ => self.explicit()?,
        };
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        if !(1..=12).contains(&third) {
            self.vertices.push(c);
        }
        Ok([a, b, c])
    }

    /// The triangle of three codes: 0 for the next index, 15 for an explicit one, else 1 more than a vertex's age.
    fn alone(&mut self, codes: [usize; 3]) -> Result<[u32; 3]> {
        let mut corners = [0; 3];
        for (corner, code) in corners.iter_mut().zip(codes) {
            *corner = match code {
                0 => self.take_next(),
                15 => self.explicit()?,
                _ => self.vertices.get(code - 1)?,
            };
        }
        let [a, b, c] = corners;
        for edge in [[b, a], [c, b], [a, c]] {
            self.edges.push(edge);
        }
        for (corner, code) in corners.into_iter().zip(codes) {
            if matches!(code, 0 | 15) {
                self.vertices.push(corner);
            }
        }
        Ok(corners)
    }
}

fn nibbles(byte: u8) -> [usize; 2] {
    [byte >> 4, byte & 15].map(usize::from)
}

/// Mode 1: `count` indices of `stride` bytes, three for each triangle.
pub(super) fn triangles(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>> {
    if stream.first() != Some(&0xe1) {
        return Err("unknown version of the triangles");
    }
    let (mut data, table) = parts(stream, 16)?;
    if table[14..] != [0, 0] || table.iter().any(|byte| nibbles(*byte).contains(&15)) {
        return Err("the table of codes has entries that are not allowed");
    }
    let codes = data.take(count / 3)?;
    let mut state = Triangles { data, next: 0, last: 0, edges: Fifo::new(), vertices: Fifo::new() };
    let mut decoded = Vec::with_capacity(codes.len() * 3 * stride);
    for code in codes {
        let corners = match nibbles(*code) {
            [15, which @ (14 | 15)] => {
                let byte = state.data.byte()?;
                if byte == 0 {
                    state.next = 0;
                }
                let [b, c] = nibbles(byte);
                state.alone([if which == 14 { 0 } else { 15 }, b, c])?
            }
            [15, entry] => {
                let [b, c] = nibbles(table[entry]);
                state.alone([0, b, c])?
            }
            [edge, third] => state.on_edge(edge, third)?,
        };
        for corner in corners {
            emit(&mut decoded, corner, stride);
        }
    }
    state.data.finish()?;
    Ok(decoded)
}

/// Mode 2: `count` indices of `stride` bytes.
pub(super) fn indices(stream: &[u8], count: usize, stride: usize) -> Result<Vec<u8>> {
    if stream.first() != Some(&0xd1) {
        return Err("unknown version of the indices");
    }
    let (mut data, _) = parts(stream, 4)?;
    let mut last = [0u32; 2];
    let mut decoded = Vec::new();
    for _ in 0..count {
        let value = data.varint()?;
        let last = &mut last[(value & 1) as usize];
        *last = last.wrapping_add(zigzag(value >> 1));
        emit(&mut decoded, *last, stride);
    }
    data.finish()?;
    Ok(decoded)
}
