use super::*;
use crate::bus::{Bus, Port, PortFault, SLACK};
use crate::emulator::virtual_port::servos;
use crate::opened::Opened;
use crate::serial::OpenFault;

const MS: u64 = 1_000_000;

fn simulated() -> Simulated {
    Simulated::open(Emulator::new(servos(&[1, 2]), 1_000_000, 1), 7_000 * MS).unwrap()
}

fn port(at: &Simulated) -> Opened {
    Opened::open(at.path(), 1_000_000).unwrap()
}

#[test]
fn a_bus_in_simulated_time_answers_however_long_the_computer_takes() {
    let servos = simulated();
    let mut bus = Bus::new(port(&servos), 1_000_000, SLACK);
    let begun = bus.port().now();
    assert_eq!(begun, 7_000 * MS);
    for _ in 0..3 {
        std::thread::sleep(Duration::from_millis(60));
        assert_eq!(bus.ping(2).map(|found| found.0), Ok(1200));
    }
    let passed = bus.port().now() - begun;
    assert!(passed < 3 * MS, "{passed} ns, three questions of 0.3 ms");
    assert_eq!(
        bus.ping(3).ok(),
        None,
        "no servo answers: until the time is over"
    );
}

#[test]
fn one_master_at_a_time_has_the_port() {
    let servos = simulated();
    let first = port(&servos);
    assert!(matches!(
        Opened::open(servos.path(), 1_000_000),
        Err(OpenFault::Busy(_))
    ));
    drop(first);
    drop(port(&servos));
}

#[test]
fn stepped_time_goes_as_far_as_it_is_granted() {
    let servos = simulated();
    servos.hold(10_000 * MS);
    let mut master = port(&servos);
    let thread = std::thread::spawn(move || {
        let mut times = vec![];
        for step in 1..=4 {
            master.wait((10_000 + 10 * step) * MS);
            times.push(master.now());
        }
        times
    });
    assert!(servos.advance(10_025 * MS, Duration::from_secs(10)));
    assert_eq!(servos.now(), 10_025 * MS);
    assert!(servos.waiting(), "the next step is beyond");
    assert!(!servos.advance(10_040 * MS, Duration::from_millis(1)) || !servos.waiting());
    let times = thread.join().unwrap();
    assert_eq!(times, [10_010, 10_020, 10_030, 10_040].map(|ms| ms * MS));
}

#[test]
fn a_late_computer_is_left_out_of_paced_time_and_counted() {
    let servos = simulated();
    let mut master = port(&servos);
    let begun = master.now();
    master.wait(begun + 10 * MS);
    let real = Instant::now();
    master.wait(begun + 40 * MS);
    assert!(real.elapsed() > Duration::from_millis(25), "it keeps pace");
    std::thread::sleep(Duration::from_millis(150));
    let late = Instant::now();
    master.wait(begun + 50 * MS);
    assert_eq!(master.now(), begun + 50 * MS);
    assert!(late.elapsed() < Duration::from_millis(100));
    assert!(servos.there(None) > Duration::from_millis(100));
}

#[test]
fn paced_time_stands_while_the_driving_program_is_away() {
    let servos = simulated();
    let mut master = port(&servos);
    let begun = master.now();
    servos.there(Some(Duration::from_millis(1)));
    let thread = std::thread::spawn(move || {
        master.wait(begun + 10 * MS);
        master.wait(begun + 20 * MS);
    });
    std::thread::sleep(Duration::from_millis(200));
    assert!(!thread.is_finished());
    servos.there(None);
    thread.join().unwrap();
    assert!(servos.there(None) > Duration::from_millis(100));
}

#[test]
fn an_unplugged_port_is_gone_and_keeps_no_caller_waiting() {
    let mut servos = simulated();
    servos.hold(0);
    let mut master = port(&servos);
    let thread = std::thread::spawn(move || {
        let until = master.now() + 10_000 * MS;
        master.wait(until);
        (master.now() >= until, master.send(&[1], 0))
    });
    while !servos.waiting() {
        std::thread::yield_now();
    }
    servos.unplug();
    assert_eq!(thread.join().unwrap(), (true, Err(PortFault::Gone)));
    assert!(!std::path::Path::new(servos.path()).exists());
}
