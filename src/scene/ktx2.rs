//! Images in KTX2 files, as KHR_texture_basisu allows them: ETC1S and UASTC, supercompressed or not.
//!
//! The container is read here, and checked. The crate `basisu` decodes the texels of the largest level, from a
//! container that is written here: its own reader adds up offsets of the file without a check.

use std::io::Read;

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use ruzstd::decoding::StreamingDecoder;

type Result<T> = std::result::Result<T, String>;

/// The first bytes of every KTX2 file.
pub(super) const MAGIC: &[u8] = b"\xabKTX 20\xbb\r\n\x1a\n";

/// Bytes of the header before the index of levels, of an entry of this index, and of a data format descriptor: without
/// and with a second sample, which is alpha in ETC1S.
const HEADER: usize = 80;
const LEVEL: usize = 24;
const DESCRIPTORS: [usize; 2] = [44, 60];

/// The byte of a descriptor whose lower half names the channel of its first sample (Khronos Data Format 1.3).
const CHANNEL: usize = 31;
/// Red, in ETC1S. A second sample is green then, in the place of alpha.
const ETC1S_RRR: u8 = 3;
/// Red three times, and green in the place of alpha, in UASTC.
const UASTC_RRRG: u8 = 5;

/// Bytes of a block of 4 x 4 texels in UASTC.
const UASTC_BLOCK: u64 = 16;

/// Texels that every file may have, 2048 x 2048, and texels for each byte of a longer file. A run of equal blocks takes
/// a few bits in ETC1S. Zstandard has blocks of 128 KiB in 4 bytes, and UASTC has a byte a texel.
const FREE: u64 = 1 << 22;
const DENSEST: u64 = 1 << 15;

/// Window of Zstandard that any file may request: that of the usual compression levels. Files with more content may
/// request a window as large as the content.
const WINDOW: u64 = 8 << 20;

#[derive(Clone, Copy, PartialEq)]
enum Coding {
    Etc1s,
    Uastc,
    UastcZstandard,
}

/// A KTX2 file whose header has been read and is plausible for the length of the file.
pub(super) struct Ktx2<'a> {
    coding: Coding,
    /// Width and height, both at least 1.
    pub size: [u32; 2],
    descriptor: &'a [u8],
    /// The largest level, as stored.
    level: &'a [u8],
    /// Global data of ETC1S.
    global: &'a [u8],
    levels: usize,
}

fn u16_at(bytes: &[u8], at: usize) -> Result<usize> {
    let word = bytes.get(at..at + 2).ok_or("ends within a header")?;
    Ok(usize::from(u16::from_le_bytes([word[0], word[1]])))
}

fn u32_at(bytes: &[u8], at: usize) -> Result<u32> {
    let word = bytes.get(at..at + 4).ok_or("ends within a header")?;
    Ok(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
}

/// A number of 64 bits; those above 32 must be zero.
fn u64_at(bytes: &[u8], at: usize) -> Result<usize> {
    match u32_at(bytes, at + 4)? {
        0 => Ok(u32_at(bytes, at)? as usize),
        _ => Err("has an offset or a length beyond 4 GiB".into()),
    }
}

fn range(bytes: &[u8], offset: usize, length: usize) -> Result<&[u8]> {
    let range = offset.checked_add(length).and_then(|end| bytes.get(offset..end));
    range.ok_or_else(|| format!("has {length} bytes at {offset}, but {} in all", bytes.len()))
}

impl<'a> Ktx2<'a> {
    /// Reads the header.
    pub fn open(bytes: &'a [u8]) -> Result<Self> {
        if !bytes.starts_with(MAGIC) {
            return Err("is not KTX2".into());
        }
        let word = |i: usize| u32_at(bytes, MAGIC.len() + 4 * i);
        let (width, height) = (word(2)?, word(3)?);
        if [word(4)?, word(5)?, word(6)?] != [0, 0, 1] || width == 0 || height == 0 {
            return Err("is not a single image in two dimensions".into());
        }
        let levels = word(7)? as usize;
        if !(1..=32).contains(&levels) {
            return Err(format!("has {levels} levels"));
        }
        // The index of levels starts with the largest one.
        let level = range(bytes, u64_at(bytes, HEADER)?, u64_at(bytes, HEADER + 8)?)?;
        let length = u64_at(bytes, HEADER + 16)?;
        let descriptor = range(bytes, word(9)? as usize, word(10)? as usize)?;
        if !DESCRIPTORS.contains(&descriptor.len()) {
            return Err(format!("has a data format descriptor of {} bytes", descriptor.len()));
        }
        let (model, scheme) = (descriptor[12], word(8)?);
        let coding = match (word(0)?, model, scheme) {
            (0, 163, 1) => Coding::Etc1s,
            (0, 166, 0) => Coding::Uastc,
            (0, 166, 2) => Coding::UastcZstandard,
            (format, ..) => {
                return Err(format!(
                    "has Vulkan format {format}, colour model {model} and supercompression {scheme}: only ETC1S and \
                     UASTC are decoded"
                ));
            }
        };
        let blocks = u64::from(width.div_ceil(4)) * u64::from(height.div_ceil(4));
        let texels = blocks.saturating_mul(16);
        if texels > FREE.max(DENSEST * bytes.len() as u64) {
            return Err(format!("it claims {width} x {height} texels in {} bytes", bytes.len()));
        }
        let stored = if coding == Coding::UastcZstandard { length } else { level.len() };
        if coding != Coding::Etc1s && stored as u64 != blocks * UASTC_BLOCK {
            return Err(format!("has a level of {stored} bytes for {blocks} blocks"));
        }
        let global = range(bytes, u64_at(bytes, MAGIC.len() + 52)?, u64_at(bytes, MAGIC.len() + 60)?)?;
        Ok(Ktx2 { coding, size: [width, height], descriptor, level, global, levels })
    }

    /// Decodes the texels: rows of RGBA from top to bottom.
    pub fn decode(&self) -> Result<Vec<[u8; 4]>> {
        let inflated;
        let (level, global) = match self.coding {
            Coding::Uastc => (self.level, Vec::new()),
            Coding::UastcZstandard => {
                inflated = self.inflate()?;
                (&*inflated, Vec::new())
            }
            Coding::Etc1s => (self.level, self.global()?),
        };
        let file = self.canonical(level, &global);
        let decoded =
            Transcoder::new(&file).and_then(|file| file.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE));
        let decoded = decoded.map_err(|problem| format!("cannot be decoded: {problem:?}"))?;
        let mut texels = decoded.as_chunks::<4>().0.to_vec();
        if self.has_green_for_alpha() {
            texels.iter_mut().for_each(|texel| *texel = [texel[0], texel[3], 0, 255]);
        }
        if texels.len() as u64 != u64::from(self.size[0]) * u64::from(self.size[1]) {
            return Err("cannot be decoded: texels are missing".into());
        }
        Ok(texels)
    }

    /// Whether it has two channels, R and G, the second of which is stored as alpha is in others.
    fn has_green_for_alpha(&self) -> bool {
        let channel = self.descriptor[CHANNEL] & 0xf;
        match self.coding {
            Coding::Etc1s => channel == ETC1S_RRR && self.descriptor.len() == DESCRIPTORS[1],
            Coding::Uastc | Coding::UastcZstandard => channel == UASTC_RRRG,
        }
    }

    fn inflate(&self) -> Result<Vec<u8>> {
        let texels = u64::from(self.size[0].next_multiple_of(4)) * u64::from(self.size[1].next_multiple_of(4));
        let length = texels / 16 * UASTC_BLOCK;
        let decoder = StreamingDecoder::new_with_max_window_size(self.level, WINDOW.max(length));
        let mut inflated = Vec::new();
        let read = decoder.map_err(|problem| problem.to_string()).and_then(|decoder| {
            decoder.take(length + 1).read_to_end(&mut inflated).map_err(|problem| problem.to_string())
        });
        match read {
            Ok(_) if inflated.len() as u64 == length => Ok(inflated),
            Ok(_) => Err(format!("has {} bytes of Zstandard for {length} bytes of texels", self.level.len())),
            Err(problem) => Err(format!("cannot be decoded: {problem}")),
        }
    }

    /// The global data of ETC1S for the largest level alone: counts, the level's parts, and three tables, checked.
    fn global(&self) -> Result<Vec<u8>> {
        const COUNTS: usize = 20;
        const IMAGE: usize = 20;
        let global = self.global;
        if u16_at(global, 0)? == 0 || u16_at(global, 2)? == 0 {
            return Err("has no endpoints or no selectors".into());
        }
        let lengths = [4, 8, 12].map(|at| u32_at(global, at).map(|length| length as usize));
        let [endpoints, selectors, tables] = lengths;
        let length = [endpoints?, selectors?, tables?].iter().try_fold(0usize, |sum, n| sum.checked_add(*n));
        let length = length.ok_or("has tables beyond 4 GiB")?;
        let image = range(global, COUNTS, IMAGE)?;
        let has_alpha = self.descriptor.len() == DESCRIPTORS[1];
        range(self.level, u32_at(image, 4)? as usize, u32_at(image, 8)? as usize)?;
        if has_alpha {
            range(self.level, u32_at(image, 12)? as usize, u32_at(image, 16)? as usize)?;
        }
        if u32_at(image, 0)? != 0 {
            return Err("is a frame of a video".into());
        }
        let tables = range(global, COUNTS + self.levels * IMAGE, length)?;
        Ok([&global[..COUNTS], image, tables].concat())
    }

    /// A KTX2 file of the largest level only, with this content.
    fn canonical(&self, level: &[u8], global: &[u8]) -> Vec<u8> {
        let first = HEADER + LEVEL;
        let at = [first, first + self.descriptor.len(), first + self.descriptor.len() + global.len()];
        let is_etc1s = self.coding == Coding::Etc1s;
        let [width, height] = self.size;
        let words = [0, 1, width, height, 0, 0, 1, 1, u32::from(is_etc1s), at[0] as u32, self.descriptor.len() as u32];
        let mut file = MAGIC.to_vec();
        file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        // There are no key-value data.
        file.extend([0; 8]);
        let uncompressed = if is_etc1s { 0 } else { level.len() };
        let long = [if is_etc1s { at[1] } else { 0 }, global.len(), at[2], level.len(), uncompressed];
        file.extend(long.iter().flat_map(|word| (*word as u64).to_le_bytes()));
        for part in [self.descriptor, global, level] {
            file.extend_from_slice(part);
        }
        file
    }
}
