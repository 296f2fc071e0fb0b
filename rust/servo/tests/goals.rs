//! Goal positions on the wire: every sent number arrives unchanged.

use softmap_servo::decoder::Decoder;
use softmap_servo::packet::{BROADCAST, LONGEST, Packet, instruction};

const GOAL: u16 = 116;

/// Send two goals in one packet, as the loop does, and decode them.
fn arrives(decoder: &mut Decoder, first: i32, second: i32) {
    let mut buffer = [0; LONGEST];
    let mut sent = Packet::new(&mut buffer, BROADCAST, instruction::SYNC_WRITE);
    sent.word(GOAL);
    sent.word(4);
    for (id, goal) in [(1, first), (2, second)] {
        sent.byte(id);
        sent.bytes(&goal.to_le_bytes());
    }
    decoder.push(sent.finish().expect("two goals fit"));
    let told = decoder.next(LONGEST).expect("a whole packet");
    let goal = |at: usize| i32::from_le_bytes(told.parameters[at..at + 4].try_into().unwrap());
    assert_eq!((told.parameters[4], goal(5)), (1, first));
    assert_eq!((told.parameters[9], goal(10)), (2, second));
}

fn round_trips(count: u64, step: u32) {
    let mut decoder = Decoder::default();
    let mut goal = 0u32;
    for _ in 0..count {
        // The other servo has its complement: as many bytes 0xFF as there are zeros here.
        arrives(&mut decoder, goal as i32, !goal as i32);
        goal = goal.wrapping_add(step);
    }
    assert_eq!((decoder.skipped, decoder.damaged), (0, 0));
}

#[test]
fn a_million_goals_arrive_as_they_were_sent() {
    round_trips(1_000_000, 2_654_435_769);
}

#[test]
#[ignore = "five minutes; `make prove` runs it"]
fn every_goal_arrives_as_it_was_sent() {
    round_trips(1 << 31, 1);
}
