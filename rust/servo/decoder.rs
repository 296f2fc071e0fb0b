//! Packets of Dynamixel Protocol 2.0, found in a stream of bytes that may hold anything.
//!
//! A header is accepted only once its full packet is there and the checksum agrees; else the
//! search goes on one byte behind it, so that junk never hides what follows. As no packet holds a
//! header (byte stuffing), a packet that another one begins in was cut short and is given up at
//! once. A length beyond what is expected is no packet. Nothing is allocated, and no byte is looked
//! at twice without reason. Pinned by the tests below: any bytes, cut anywhere.

use crate::crc::crc;
use crate::packet::{BROADCAST, HEAD, HEADER, LONGEST, instruction::STATUS};

/// Bytes of the shortest packet: head, instruction, checksum.
const SHORTEST: usize = HEAD + 3;
/// Bytes that are kept at most: the longest packet, and what a read brings beyond it.
const ROOM: usize = 2 * LONGEST;

/// A packet as it was received, its parameters without stuffing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received<'a> {
    pub id: u8,
    pub instruction: u8,
    pub parameters: &'a [u8],
}

impl<'a> Received<'a> {
    /// As an answer: its error byte and what follows.
    pub fn status(&self) -> Option<(u8, &'a [u8])> {
        match self.parameters.split_first() {
            Some((error, data)) if self.instruction == STATUS => Some((*error, data)),
            _ => None,
        }
    }
}

/// Bytes received, and where reading goes on.
#[derive(Debug, Clone)]
pub struct Decoder {
    bytes: [u8; ROOM],
    start: usize,
    end: usize,
    plain: [u8; LONGEST],
    /// Bytes that belonged to no packet.
    pub skipped: u64,
    /// Packets whose checksum was wrong, or that were cut short.
    pub damaged: u64,
}

impl Default for Decoder {
    fn default() -> Decoder {
        Decoder {
            bytes: [0; ROOM],
            start: 0,
            end: 0,
            plain: [0; LONGEST],
            skipped: 0,
            damaged: 0,
        }
    }
}

/// The beginning of the received bytes.
enum Found {
    /// A packet of so many bytes.
    Packet(usize),
    /// More bytes have to come first.
    Open,
    /// So many bytes belong to nothing.
    Junk(usize),
}

impl Decoder {
    /// Take in what was received; the oldest bytes give way where there is no room.
    pub fn push(&mut self, bytes: &[u8]) {
        let bytes = &bytes[bytes.len().saturating_sub(ROOM)..];
        let kept = (self.end - self.start).min(ROOM - bytes.len());
        self.skipped += (self.end - self.start - kept) as u64;
        self.bytes.copy_within(self.end - kept..self.end, 0);
        self.bytes[kept..kept + bytes.len()].copy_from_slice(bytes);
        (self.start, self.end) = (0, kept + bytes.len());
    }

    /// Forget what was received.
    pub fn clear(&mut self) {
        (self.start, self.end) = (0, 0);
    }

    /// Bytes received and not read yet.
    pub fn waiting(&self) -> &[u8] {
        &self.bytes[self.start..self.end]
    }

    /// The next packet of at most `longest` bytes, if one is complete.
    pub fn next(&mut self, longest: usize) -> Option<Received<'_>> {
        let size = loop {
            match self.look(longest.min(LONGEST)) {
                Found::Packet(size) => break size,
                Found::Open => return None,
                Found::Junk(count) => {
                    self.start += count;
                    self.skipped += count as u64;
                }
            }
        };
        let at = self.start;
        self.start += size;
        let count = unstuff(&self.bytes[at + HEAD + 1..at + size - 2], &mut self.plain);
        Some(Received {
            id: self.bytes[at + 4],
            instruction: self.bytes[at + HEAD],
            parameters: &self.plain[..count],
        })
    }

    fn look(&mut self, longest: usize) -> Found {
        let waiting = &self.bytes[self.start..self.end];
        let begin = header(waiting);
        if begin > 0 {
            return Found::Junk(begin);
        }
        if waiting.len() < HEAD {
            return Found::Open;
        }
        let size = HEAD + usize::from(u16::from_le_bytes([waiting[5], waiting[6]]));
        if !(SHORTEST..=longest).contains(&size) || waiting[4] > BROADCAST {
            self.damaged += 1;
            return Found::Junk(1);
        }
        if waiting.len() >= size && sound(&waiting[..size]) {
            return Found::Packet(size);
        }
        let cut = HEADER.len() + header(&waiting[HEADER.len()..]);
        let another = waiting.len() >= cut + HEADER.len();
        if waiting.len() >= size || another {
            self.damaged += 1;
            return Found::Junk(1);
        }
        Found::Open
    }
}

/// Where the first header begins, or may begin once more has come; `bytes.len()` where nothing
/// does.
fn header(bytes: &[u8]) -> usize {
    let begins = |at: &usize| {
        let some = (bytes.len() - at).min(HEADER.len());
        bytes[*at..at + some] == HEADER[..some]
    };
    (0..bytes.len()).find(begins).unwrap_or(bytes.len())
}

/// Whether the last two bytes are the checksum of those before.
fn sound(packet: &[u8]) -> bool {
    let (body, sum) = packet.split_at(packet.len() - 2);
    crc(0, body).to_le_bytes() == sum
}

/// Write `bytes` without stuffing to `out`, return how many they are.
fn unstuff(bytes: &[u8], out: &mut [u8]) -> usize {
    let mut count = 0;
    let mut stuffed = false;
    for byte in bytes {
        if stuffed && *byte == 0xFD {
            stuffed = false;
            continue;
        }
        out[count] = *byte;
        count += 1;
        stuffed = count >= 3 && out[count - 3..count] == [0xFF, 0xFF, 0xFD];
    }
    count
}

/// What a fast sync read brought from each servo, its place in `ids` first: error byte and `size`
/// bytes of data.
///
///   FF FF FD 00 · FE · length · 55 · (error · id · data · CRC) · (error · id · data · CRC) …
///
/// Each checksum is that of all bytes before it, so that the servos before one that is silent are
/// still heard. Places are fixed and nothing is stuffed. A slot whose checksum or id is wrong ends
/// the reading: what follows has no checksum.
pub fn fast_slots<'a>(
    bytes: &'a [u8],
    ids: &'a [u8],
    size: usize,
) -> impl Iterator<Item = (usize, u8, &'a [u8])> {
    let slot = size + 4;
    let length = ids.len() * slot + 1;
    let begin = (0..bytes.len()).find(|at| {
        let Some(some) = bytes.get(*at..at + HEAD + 1) else {
            return false;
        };
        some[..4] == HEADER
            && some[4] == BROADCAST
            && usize::from(u16::from_le_bytes([some[5], some[6]])) == length
            && some[HEAD] == STATUS
    });
    let slots = begin.map(|at| (&bytes[at..at + HEAD + 1], &bytes[at + HEAD + 1..]));
    let (first, rest) = slots.unwrap_or((&[], &[]));
    let mut sum = crc(0, first);
    rest.chunks_exact(slot)
        .zip(ids)
        .enumerate()
        .map_while(move |(place, (slot, id))| {
            let (body, check) = slot.split_at(slot.len() - 2);
            sum = crc(sum, body);
            let sound = body[1] == *id && sum.to_le_bytes() == check;
            sum = crc(sum, check);
            sound.then_some((place, body[0], &body[2..]))
        })
}

#[cfg(test)]
#[path = "decoder_tests.rs"]
mod tests;
