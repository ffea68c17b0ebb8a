//! Tests of the blob: fixed bytes, and that every kind of damage is refused.

extern crate std;

use super::*;
use crate::fixtures::{blob, rope, text};
use crate::policy::Layer;
use proptest::prelude::*;
use std::string::ToString;
use std::sync::LazyLock;
use std::vec;
use std::vec::Vec;

static BYTES: LazyLock<Vec<u8>> = LazyLock::new(|| bytes_of(&blob()));

fn bytes_of(blob: &Blob) -> Vec<u8> {
    let mut buffer = vec![0; MAX_BLOB_BYTES];
    write(blob, &mut buffer).expect("the fixture is valid").to_vec()
}

#[test]
fn what_is_written_is_what_is_read() {
    let read = parse(&BYTES).expect("the fixture is valid");
    assert_eq!(read, blob());
    assert_eq!(read.rope("red"), Some(&rope("red")));
    assert_eq!(read.rope("blue"), None);
}

#[test]
fn header_bytes_are_fixed() {
    assert_eq!(BYTES[..12], *b"GENORM\r\n\x02\x00\x00\x00");
    assert_eq!(BYTES[12..16], ((BYTES.len() - 20) as u32).to_le_bytes());
    assert_eq!(BYTES[16..20], GOLDEN_CRC);
    assert_eq!(BYTES.len(), GOLDEN_LENGTH);
}

/// The CRC of the fixture; it changes with any byte of the format.
const GOLDEN_CRC: [u8; 4] = [241, 182, 228, 216];
const GOLDEN_LENGTH: usize = 152_946;

#[test]
fn payload_bytes_are_fixed() {
    let layer = Layer::<2, 1>::from_rows(&[1.0, -2.0], &[0.5]).expect("the sizes fit");
    let mut buffer = [0; 16];
    let bytes = postcard::to_slice(&layer, &mut buffer).expect("12 bytes fit");
    assert_eq!(bytes, [0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, 0, 0, 0, 0x3f]);

    let provenance = blob().provenance;
    let mut buffer = [0; 64];
    let bytes = postcard::to_slice(&provenance, &mut buffer).expect("it fits");
    assert_eq!(bytes, b"\x01\x01\x02\x03\x04\x0doffline 0.1.0");
}

#[test]
fn the_largest_blob_fits_the_buffer() {
    let mut largest = blob();
    let long = "n".repeat(32);
    let mut entry = rope("red");
    while entry.effects.len() < MAX_EFFECTS {
        entry
            .effects
            .push(entry.effects[0].clone())
            .expect("below the capacity");
    }
    for effect in &mut entry.effects {
        effect.name = text(&long);
        effect.parameter = text(&long);
    }
    largest.ropes.clear();
    for index in 0..MAX_ROPES {
        let mut name = index.to_string();
        name.push_str(&long[name.len()..]);
        entry.name = text(&name);
        largest.ropes.push(entry.clone()).expect("below the capacity");
    }
    largest.provenance.demos = heapless::Vec::from_slice(&[u64::MAX; MAX_DEMOS]).expect("at the capacity");
    largest.provenance.program = text(&long);
    assert_eq!(parse(&bytes_of(&largest)), Ok(largest));
}

#[test]
fn each_damage_has_its_error() {
    let parse_changed = |at: usize, value: u8| {
        let mut bytes = BYTES.clone();
        bytes[at] ^= value;
        parse(&bytes).unwrap_err()
    };
    assert_eq!(parse_changed(0, 1), BlobError::Magic);
    assert_eq!(parse_changed(8, 3), BlobError::Version { found: 1 });
    assert_eq!(parse_changed(16, 1), BlobError::Checksum);
    assert_eq!(parse_changed(5000, 1), BlobError::Checksum);
    assert_eq!(
        parse(b"").unwrap_err(),
        BlobError::Truncated {
            found: 0,
            expected: 20
        }
    );
    let mut longer = BYTES.clone();
    longer.push(0);
    assert!(matches!(parse(&longer), Err(BlobError::Trailing { .. })));
    assert_eq!(write(&blob(), &mut [0; 100]).unwrap_err(), BlobError::Buffer);
}

/// A payload with an intact header around it.
fn sealed(payload: &[u8]) -> Vec<u8> {
    let mut bytes = BYTES[..12].to_vec();
    bytes.extend((payload.len() as u32).to_le_bytes());
    let crc = checksum(&bytes, payload);
    bytes.extend(crc.to_le_bytes());
    bytes.extend(payload);
    bytes
}

#[test]
fn a_wrong_payload_behind_a_right_checksum_is_refused() {
    assert_eq!(sealed(&BYTES[HEADER_BYTES..]), *BYTES);
    let mut payload = BYTES[HEADER_BYTES..].to_vec();
    payload.push(0);
    assert_eq!(parse(&sealed(&payload)).unwrap_err(), BlobError::Payload);
    payload.truncate(payload.len() - 3);
    assert_eq!(parse(&sealed(&payload)).unwrap_err(), BlobError::Payload);
    let mut payload = BYTES[HEADER_BYTES..].to_vec();
    payload[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(
        parse(&sealed(&payload)).unwrap_err(),
        BlobError::Policy(PolicyError::Weights)
    );
}

/// A change that makes the fixture implausible.
type Spoil = fn(&mut Blob);

#[test]
fn implausible_numbers_are_refused() {
    let spoilt: [Spoil; 15] = [
        |blob| blob.ropes.clear(),
        |blob| blob.ropes.push(rope("red")).expect("below the capacity"),
        |blob| blob.ropes[0].name.clear(),
        |blob| blob.ropes[0].young_pa = f64::NAN,
        |blob| blob.ropes[0].young_pa = 1e7,
        |blob| blob.ropes[0].poisson = 0.5,
        |blob| blob.ropes[0].young_se_pa = -1.0,
        |blob| blob.ropes[0].length_m = 300.0,
        |blob| blob.ropes[0].length_m = 0.27,
        |blob| blob.ropes[0].reach_m.low = 1.0,
        |blob| blob.ropes[0].effects[0].value = f64::INFINITY,
        |blob| blob.motion.speed_m_s = 1.5,
        |blob| blob.task.dwell_s = f64::NAN,
        |blob| blob.task.release_x_m.high = 0.2,
        |blob| blob.frame.origin_m[1] = 40.0,
    ];
    for (index, spoil) in spoilt.iter().enumerate() {
        let mut bad = blob();
        spoil(&mut bad);
        let refused = write(&bad, &mut vec![0; MAX_BLOB_BYTES]).is_err();
        assert!(refused, "spoilt blob {index} was accepted");
    }
}

#[test]
fn the_frame_turns_about_z() {
    let frame = TaskFrame {
        origin_m: [1.0, 2.0, 3.0],
        yaw_rad: core::f64::consts::FRAC_PI_2,
    };
    let flange = frame.flange_m([0.5, 0.25]);
    for (found, expected) in flange.iter().zip([1.0, 2.5, 3.25]) {
        assert!((found - expected).abs() < 1e-12);
    }
}

proptest! {
    #[test]
    fn any_flipped_bit_is_refused(at in 0..BYTES.len(), bit in 0..8) {
        let mut bytes = BYTES.clone();
        bytes[at] ^= 1u8 << bit;
        prop_assert!(parse(&bytes).is_err());
    }

    #[test]
    fn any_flipped_header_bit_is_refused(at in 0..HEADER_BYTES, bit in 0..8) {
        let mut bytes = BYTES.clone();
        bytes[at] ^= 1u8 << bit;
        prop_assert!(parse(&bytes).is_err());
    }

    #[test]
    fn any_truncation_is_refused(length in 0..BYTES.len()) {
        let refused = matches!(parse(&BYTES[..length]), Err(BlobError::Truncated { .. }));
        prop_assert!(refused);
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(parse(&bytes).is_err());
        prop_assert!(parse(&sealed(&bytes)).is_err());
    }
}

#[test]
fn parsing_fits_a_small_stack() {
    let bytes: &'static [u8] = &BYTES;
    let thread = std::thread::Builder::new().stack_size(1024 * 1024);
    let parsed = thread
        .spawn(move || parse(bytes).is_ok())
        .expect("threads can be made");
    assert!(parsed.join().expect("no panic"));
}
