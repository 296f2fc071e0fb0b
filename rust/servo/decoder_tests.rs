use super::*;
use crate::packet::{Packet, instruction, packet};
use proptest::prelude::*;

fn status(id: u8, data: &[u8]) -> Vec<u8> {
    let mut buffer = [0; LONGEST];
    let mut packet = Packet::new(&mut buffer, id, STATUS);
    packet.byte(0);
    packet.bytes(data);
    packet.finish().unwrap().to_vec()
}

fn all(decoder: &mut Decoder, longest: usize) -> Vec<(u8, u8, Vec<u8>)> {
    let mut found = vec![];
    while let Some(packet) = decoder.next(longest) {
        found.push((packet.id, packet.instruction, packet.parameters.to_vec()));
    }
    found
}

/// Bytes that are mostly those of headers and stuffing.
fn nasty() -> impl Strategy<Value = u8> {
    prop_oneof![3 => Just(0xFF), 3 => Just(0xFD), 1 => Just(0u8), 1 => Just(1u8), 1 => any::<u8>()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn what_was_written_is_read(data in prop::collection::vec(nasty(), 0..300), id in 0u8..=252, cut in 0usize..40) {
        let sent = status(id, &data);
        let mut decoder = Decoder::default();
        for piece in sent.chunks(cut + 1) {
            decoder.push(piece);
        }
        let received = decoder.next(LONGEST).unwrap();
        prop_assert_eq!(received.id, id);
        let (error, read) = received.status().unwrap();
        prop_assert_eq!((error, read), (0, &data[..]));
        prop_assert!(decoder.waiting().is_empty() && decoder.skipped == 0 && decoder.damaged == 0);
    }

    #[test]
    fn junk_before_a_packet_never_hides_it(junk in prop::collection::vec(nasty(), 0..60), data in prop::collection::vec(nasty(), 0..40)) {
        let mut decoder = Decoder::default();
        decoder.push(&junk);
        decoder.push(&status(9, &data));
        let mut expected = vec![0];
        expected.extend(&data);
        prop_assert!(all(&mut decoder, LONGEST).contains(&(9, STATUS, expected)));
    }

    #[test]
    fn any_bytes_are_survived(pieces in prop::collection::vec(prop::collection::vec(nasty(), 0..700), 0..8), longest in 0usize..1200) {
        let mut decoder = Decoder::default();
        let mut count = 0;
        for piece in &pieces {
            count += piece.len();
            decoder.push(piece);
            for (id, _, parameters) in all(&mut decoder, longest) {
                prop_assert!(id <= BROADCAST && parameters.len() + SHORTEST <= longest.min(LONGEST));
            }
        }
        prop_assert!(decoder.skipped <= count as u64 && decoder.waiting().len() <= ROOM);
        fast_slots(decoder.waiting(), &[1, 2, 3], longest).for_each(drop);
    }

    #[test]
    fn a_flipped_bit_is_never_believed(data in prop::collection::vec(any::<u8>(), 1..30), place in 0usize..200, bit in 0u8..8) {
        let mut sent = status(3, &data);
        let place = place % sent.len();
        sent[place] ^= 1 << bit;
        let mut decoder = Decoder::default();
        decoder.push(&sent);
        decoder.push(&status(4, &[7]));
        decoder.push(&status(5, &[8]));
        let found = all(&mut decoder, LONGEST);
        let ids: Vec<u8> = found.iter().map(|packet| packet.0).filter(|id| *id != 3).collect();
        prop_assert_eq!(ids, vec![4, 5]);
        // A shorter length may match a checksum by chance; no request was for that many bytes.
        let believed = found.iter().find(|packet| packet.0 == 3);
        prop_assert!(believed.is_none_or(|packet| matches!(place, 5 | 6) && packet.2.len() != data.len() + 1));
    }
}

#[test]
fn a_packet_cut_short_gives_way_to_the_next_at_once() {
    let whole = status(1, &[1, 2, 3, 4, 5, 6, 7, 8]);
    for cut in 4..whole.len() {
        let mut decoder = Decoder::default();
        decoder.push(&whole[..cut]);
        assert!(decoder.next(LONGEST).is_none());
        decoder.push(&status(2, &[]));
        assert_eq!(decoder.next(LONGEST).unwrap().id, 2, "cut at {cut}");
        assert_eq!(decoder.skipped, cut as u64);
        assert!(decoder.damaged >= 1);
    }
}

#[test]
fn a_length_of_no_request_is_not_waited_for() {
    let mut decoder = Decoder::default();
    decoder.push(&[0xFF, 0xFF, 0xFD, 0x00, 1, 200, 0]);
    assert!(decoder.next(20).is_none() && decoder.damaged == 1);
    let mut decoder = Decoder::default();
    decoder.push(&[0xFF, 0xFF, 0xFD, 0x00, 0xFF, 4, 0]);
    assert!(decoder.next(20).is_none() && decoder.damaged == 1);
    let mut decoder = Decoder::default();
    decoder.push(&[0xFF, 0xFF, 0xFD, 0x00, 1, 2, 0]);
    assert!(decoder.next(20).is_none() && decoder.damaged == 1);
    let exact = status(1, &[1, 2, 3]);
    decoder.clear();
    decoder.push(&exact);
    assert_eq!(decoder.clone().next(exact.len()).unwrap().id, 1);
    assert!(decoder.next(exact.len() - 1).is_none());
}

#[test]
fn an_answer_is_a_status_with_an_error_byte() {
    let mut decoder = Decoder::default();
    let mut buffer = [0; LONGEST];
    decoder.push(packet(&mut buffer, 1, instruction::PING, &[5]).unwrap());
    assert_eq!(decoder.next(LONGEST).unwrap().status(), None);
    decoder.push(packet(&mut buffer, 1, STATUS, &[]).unwrap());
    assert_eq!(decoder.next(LONGEST).unwrap().status(), None);
    decoder.push(packet(&mut buffer, 1, STATUS, &[0x84]).unwrap());
    assert_eq!(
        decoder.next(LONGEST).unwrap().status(),
        Some((0x84, &[][..]))
    );
}

#[test]
fn more_than_there_is_room_for_pushes_the_oldest_out() {
    let mut decoder = Decoder::default();
    decoder.push(&[7; ROOM + 5]);
    assert_eq!(decoder.waiting().len(), ROOM);
    let last = status(8, &[1]);
    decoder.push(&last);
    assert_eq!(decoder.waiting().len(), ROOM);
    assert_eq!(decoder.skipped, last.len() as u64);
    assert_eq!(all(&mut decoder, LONGEST)[0].0, 8);
}

/// An answer to a fast sync read.
fn fast(ids: &[u8], data: &[&[u8]]) -> Vec<u8> {
    let length = ids.len() * (data[0].len() + 4) + 1;
    let mut bytes = HEADER.to_vec();
    bytes.push(BROADCAST);
    bytes.extend((length as u16).to_le_bytes());
    bytes.push(STATUS);
    for (id, data) in ids.iter().zip(data) {
        bytes.push(0x80);
        bytes.push(*id);
        bytes.extend(*data);
        bytes.extend(crc(0, &bytes).to_le_bytes());
    }
    bytes
}

#[test]
fn servos_before_a_silent_one_are_heard() {
    let data: [&[u8]; 3] = [&[1, 2], &[0xFF, 0xFF], &[0xFD, 0x00]];
    let whole = fast(&[4, 5, 6], &data);
    let heard = |bytes: &[u8]| {
        fast_slots(bytes, &[4, 5, 6], 2)
            .map(|(k, e, d)| (k, e, d.to_vec()))
            .collect::<Vec<_>>()
    };
    let expected: Vec<_> = data
        .iter()
        .enumerate()
        .map(|(k, d)| (k, 0x80, d.to_vec()))
        .collect();
    assert_eq!(heard(&whole), expected);
    for cut in 0..whole.len() {
        let count = cut.saturating_sub(HEAD + 1) / 6;
        assert_eq!(heard(&whole[..cut]), expected[..count], "cut at {cut}");
    }
    let junk = [&[0xFF, 0xFF, 0xFD, 0x00, 0xFE, 3][..], &whole].concat();
    assert_eq!(heard(&junk), expected);
    for place in HEAD + 1..whole.len() {
        let mut bad = whole.clone();
        bad[place] ^= 1;
        assert_eq!(
            heard(&bad),
            expected[..(place - HEAD - 1) / 6],
            "byte {place}"
        );
    }
    assert!(fast_slots(&whole, &[4, 5], 2).next().is_none());
    assert!(fast_slots(&whole, &[3, 5, 6], 2).next().is_none());
    assert!(fast_slots(&whole, &[4, 5, 6], 3).next().is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn a_packet_is_not_given_up_while_it_arrives(data in prop::collection::vec(nasty(), 0..60)) {
        let sent = status(6, &data);
        let mut decoder = Decoder::default();
        for byte in &sent[..sent.len() - 1] {
            decoder.push(&[*byte]);
            prop_assert!(decoder.next(LONGEST).is_none());
        }
        decoder.push(&sent[sent.len() - 1..]);
        prop_assert_eq!(decoder.next(LONGEST).unwrap().status(), Some((0, &data[..])));
        prop_assert_eq!((decoder.skipped, decoder.damaged), (0, 0));
    }
}

#[test]
fn without_a_header_a_checksum_makes_no_packet() {
    for place in 0..HEADER.len() {
        let mut bytes = status(1, &[2, 3]);
        bytes[place] ^= 0x10;
        let end = bytes.len() - 2;
        let sum = crc(0, &bytes[..end]).to_le_bytes();
        bytes[end..].copy_from_slice(&sum);
        let mut decoder = Decoder::default();
        decoder.push(&bytes);
        assert!(decoder.next(LONGEST).is_none(), "byte {place}");
        assert_eq!(
            (decoder.skipped, decoder.damaged),
            (bytes.len() as u64, 0),
            "byte {place}"
        );
    }
}

#[test]
fn the_longest_packet_fits_with_a_further_read() {
    let longest = status(1, &[7; LONGEST - HEAD - 4]);
    assert_eq!(longest.len(), LONGEST);
    let next = status(2, &[9; 300]);
    let mut decoder = Decoder::default();
    decoder.push(&longest[..LONGEST - 1]);
    assert!(decoder.next(LONGEST).is_none());
    decoder.push(&[&longest[LONGEST - 1..], &next].concat());
    let ids: Vec<u8> = all(&mut decoder, LONGEST).iter().map(|one| one.0).collect();
    assert_eq!((ids, decoder.skipped), (vec![1, 2], 0));
}
