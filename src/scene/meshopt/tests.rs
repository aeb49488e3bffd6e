//! Our decoder against the official encoder and decoder, in C++.

use super::bitstream::{attributes, indices, triangles};
use super::filter::Filter;

/// Pseudo-random numbers (xorshift32).
struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    fn below(&mut self, end: u32) -> u32 {
        self.next() % end
    }

    fn signed_unit(&mut self) -> f32 {
        self.next() as f32 / u32::MAX as f32 * 2.0 - 1.0
    }
}

/// Elements whose bytes behave in several ways: constant, slowly changing, floats, noise.
fn elements<const N: usize>(count: usize, random: &mut Random) -> Vec<[u8; N]> {
    let kinds: Vec<u32> = (0..N / 4).map(|_| random.below(5)).collect();
    let mut words = vec![0u32; N / 4];
    let element = |_| {
        let mut element = [0; N];
        for ((word, kind), bytes) in words.iter_mut().zip(&kinds).zip(element.as_chunks_mut::<4>().0) {
            *word = match kind {
                0 => *word,
                1 => word.wrapping_add(random.below(3)),
                2 => word.wrapping_add(random.below(9) << 16 | random.below(300)),
                3 => random.signed_unit().to_bits(),
                _ => random.next(),
            };
            *bytes = word.to_le_bytes();
        }
        element
    };
    (0..count).map(element).collect()
}

fn same_attributes<const N: usize>(random: &mut Random) {
    for count in [1, 2, 15, 16, 17, 31, 255, 256, 257, 700] {
        for version in [0, 1] {
            for level in 0..=3 {
                let plain = elements::<N>(count, random);
                let coded = meshopt::encode_vertex_buffer_level(&plain, level, Some(version)).unwrap();
                assert_eq!(coded[0], 0xa0 + version as u8);
                let decoded = attributes(&coded, count, N);
                assert!(decoded.as_deref() == Ok(plain.as_flattened()), "{N} {count} {version} {level} {decoded:?}");
                // A stream of another length is not that stream.
                assert!(attributes(&coded[..coded.len() - 1], count, N).as_deref() != Ok(plain.as_flattened()));
                let longer = [&coded[..1], &[0], &coded[1..]].concat();
                assert!(attributes(&longer, count, N).as_deref() != Ok(plain.as_flattened()));
            }
        }
    }
}

#[test]
fn attributes_have_the_bits_of_their_twins() {
    let mut random = Random(1);
    same_attributes::<4>(&mut random);
    same_attributes::<8>(&mut random);
    same_attributes::<12>(&mut random);
    same_attributes::<20>(&mut random);
    same_attributes::<32>(&mut random);
    same_attributes::<64>(&mut random);
    same_attributes::<252>(&mut random);
    same_attributes::<256>(&mut random);
}

fn plain_bytes(indices: &[u32], stride: usize) -> Vec<u8> {
    indices.iter().flat_map(|index| index.to_le_bytes()[..stride].to_vec()).collect()
}

/// A triangle may come back with its corners rotated, which the extension allows.
fn rotated(triangle: &[u32]) -> [u32; 3] {
    let [a, b, c] = [triangle[0], triangle[1], triangle[2]];
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
}

#[test]
fn indices_have_the_bits_of_their_twins() {
    let mut random = Random(2);
    let side = 24;
    let at = |x: u32, y: u32| y * side + x;
    let cells = (0..(side - 1) * (side - 1)).map(|i| (i % (side - 1), i / (side - 1)));
    let grid: Vec<u32> = cells
        .flat_map(|(x, y)| [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)])
        .collect();
    let optimised = meshopt::optimize_vertex_cache(&grid, (side * side) as usize);
    let noise: Vec<u32> = (0..900).map(|_| random.below(side * side)).collect();
    let twice = [&*optimised, &*optimised].concat();
    for list in [&grid[..3], &grid, &optimised, &noise, &twice] {
        let coded = meshopt::encode_index_buffer(list, (side * side) as usize).unwrap();
        let sequence = meshopt::encode_index_sequence(list, (side * side) as usize).unwrap();
        for stride in [2, 4] {
            assert_eq!(indices(&sequence, list.len(), stride).unwrap(), plain_bytes(list, stride));
            let decoded = triangles(&coded, list.len(), stride).unwrap();
            // The same as by the official decoder, and the triangles of the list.
            let official = meshopt::decode_index_buffer::<u32>(&coded, list.len()).unwrap();
            assert_eq!(decoded, plain_bytes(&official, stride));
            assert!(official.chunks(3).map(rotated).eq(list.chunks(3).map(rotated)));
        }
        assert!(triangles(&coded[..coded.len() - 1], list.len(), 4).is_err());
        assert!(triangles(&[&*coded, &[0]].concat(), list.len(), 4).is_err());
        assert!(indices(&sequence, list.len() + 1, 4).is_err());
        assert!(indices(&sequence, list.len() - 1, 4).is_err());
    }
}

/// The specification's example of nibbles with two that do not fit.
#[test]
fn the_example_of_the_specification() {
    let group = [0x17, 0x5f, 0xf0, 0xbc, 0x77, 0xa9, 0x21, 0x00, 0x34, 0xb5];
    // One element of four bytes has 16 deltas, of which one counts. Baseline and padding follow.
    let count = 16;
    let mut stream = vec![0xa0];
    stream.push(0b10);
    stream.extend(group);
    stream.extend([0b00; 3]);
    stream.extend([0; 32]);
    let decoded = attributes(&stream, count, 4).unwrap();
    let deltas = [-1i8, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0];
    let mut value = 0u8;
    for (element, delta) in decoded.chunks(4).zip(deltas) {
        value = value.wrapping_add(delta as u8);
        assert_eq!(element, [value, 0, 0, 0]);
    }
}

fn bytes_of<const N: usize>(words: &[[i16; N]]) -> Vec<u8> {
    words.iter().flatten().flat_map(|word| word.to_le_bytes()).collect()
}

fn words_of(bytes: &[u8]) -> Vec<i16> {
    bytes.as_chunks::<2>().0.iter().map(|word| i16::from_le_bytes(*word)).collect()
}

/// The specification allows one unit of deviation, except for exponential numbers.
#[test]
fn filters_agree_with_the_official_ones() {
    let mut random = Random(3);
    let vectors: Vec<[f32; 4]> = (0..500)
        .map(|_| {
            let v = [0; 4].map(|_| random.signed_unit());
            let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            v.map(|x| x / length)
        })
        .collect();
    let units: Vec<[f32; 4]> = vectors
        .iter()
        .map(|&[x, y, z, w]| {
            let length = (x * x + y * y + z * z).sqrt();
            [x / length, y / length, z / length, w]
        })
        .collect();
    let near = |ours: i32, theirs: i32| (ours - theirs).abs() <= 1;
    for bits in [4, 8, 10, 12, 16] {
        let coded = meshopt::encode_filter_oct::<i16>(&units, bits);
        let (mut ours, mut theirs) = (bytes_of(&coded), coded);
        Filter::Octahedral.apply(&mut ours, 8);
        meshopt::decode_filter_oct(&mut theirs);
        let pairs = words_of(&ours).into_iter().zip(theirs.into_iter().flatten());
        assert!(pairs.into_iter().all(|(a, b)| near(a.into(), b.into())), "octahedral {bits}");

        let coded = meshopt::encode_filter_quat(&vectors, bits);
        let (mut ours, mut theirs) = (bytes_of(&coded), coded);
        Filter::Quaternion.apply(&mut ours, 8);
        meshopt::decode_filter_quat(&mut theirs);
        let pairs = words_of(&ours).into_iter().zip(theirs.into_iter().flatten());
        assert!(pairs.into_iter().all(|(a, b)| near(a.into(), b.into())), "quaternion {bits}");

        let positive: Vec<[f32; 4]> = vectors.iter().map(|v| v.map(f32::abs)).collect();
        let coded = meshopt::encode_filter_color::<u16>(&positive, bits);
        let (mut ours, mut theirs) = (bytes_of(&coded.iter().map(|c| c.map(|w| w as i16)).collect::<Vec<_>>()), coded);
        Filter::Colour.apply(&mut ours, 8);
        meshopt::decode_filter_color(&mut theirs);
        let pairs = words_of(&ours).into_iter().zip(theirs.into_iter().flatten());
        assert!(pairs.into_iter().all(|(a, b)| near((a as u16).into(), b.into())), "colour {bits}");
        if bits <= 8 {
            let coded = meshopt::encode_filter_oct::<i8>(&units, bits);
            let (mut ours, mut theirs) = (coded.iter().flatten().map(|b| *b as u8).collect::<Vec<u8>>(), coded);
            Filter::Octahedral.apply(&mut ours, 4);
            meshopt::decode_filter_oct(&mut theirs);
            let pairs = ours.into_iter().zip(theirs.into_iter().flatten());
            assert!(pairs.into_iter().all(|(a, b)| near((a as i8).into(), b.into())), "octahedral bytes {bits}");

            let coded = meshopt::encode_filter_color::<u8>(&positive, bits);
            let (mut ours, mut theirs) = (coded.as_flattened().to_vec(), coded);
            Filter::Colour.apply(&mut ours, 4);
            meshopt::decode_filter_color(&mut theirs);
            let pairs = ours.into_iter().zip(theirs.into_iter().flatten());
            assert!(pairs.into_iter().all(|(a, b)| near(a.into(), b.into())), "colour bytes {bits}");
        }
        for scale in [1e-20, 1.0, 1e20] {
            let numbers: Vec<[f32; 4]> = vectors.iter().map(|v| v.map(|x| x * scale)).collect();
            let coded = meshopt::encode_filter_exp(&numbers, bits, meshopt::EncodeExpMode::SharedVector);
            let mut ours: Vec<u8> = coded.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
            let mut theirs = coded;
            Filter::Exponential.apply(&mut ours, 16);
            meshopt::decode_filter_exp(&mut theirs);
            let theirs: Vec<u8> = theirs.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
            assert_eq!(ours, theirs, "exponential {bits} {scale}");
        }
    }
}

/// Damaged streams end with an error or with other bytes, never with a panic or with more bytes than requested.
#[test]
fn damaged_streams_end() {
    let mut random = Random(4);
    let plain = elements::<12>(300, &mut random);
    let list: Vec<u32> = (0..300).map(|i| i / 3 + i % 3).collect();
    let coded = [
        meshopt::encode_vertex_buffer_level(&plain, 3, Some(1)).unwrap(),
        meshopt::encode_vertex_buffer_level(&plain, 0, Some(0)).unwrap(),
        meshopt::encode_index_buffer(&list, 300).unwrap(),
        meshopt::encode_index_sequence(&list, 300).unwrap(),
    ];
    let mut refused = 0;
    for _ in 0..20_000 {
        let mut damaged = coded[random.below(4) as usize].clone();
        for _ in 0..=random.below(3) {
            let at = random.below(damaged.len() as u32) as usize;
            damaged[at] = random.next() as u8;
        }
        damaged.truncate(damaged.len() - (random.below(8) as usize).saturating_sub(5));
        let outcomes = [attributes(&damaged, 300, 12), triangles(&damaged, 300, 4), indices(&damaged, 300, 2)];
        for (outcome, size) in outcomes.into_iter().zip([3600, 1200, 600]) {
            match outcome {
                Ok(decoded) => assert_eq!(decoded.len(), size),
                Err(_) => refused += 1,
            }
        }
    }
    // Two of three decoders refuse the first byte, and most damages are found.
    assert!(refused > 40_000, "{refused}");
}

/// Numbers outside of their valid range do not panic.
#[test]
fn filters_accept_any_bytes() {
    let mut random = Random(5);
    let bytes: Vec<u8> = (0..1 << 16).map(|_| random.next() as u8).chain([0; 64]).collect();
    for filter in [Filter::Octahedral, Filter::Quaternion, Filter::Exponential, Filter::Colour] {
        for stride in (4..=8).step_by(4).filter(|stride| filter.fits(*stride)) {
            filter.apply(&mut bytes.clone(), stride);
        }
    }
}
