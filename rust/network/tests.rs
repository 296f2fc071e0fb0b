//! The layers against plain loops in double precision, slopes against differences, and rejected
//! files.

use super::layers::normal;
use super::{Activation, Layer, Network};
use crate::allocations::allocations;
use crate::shape::{Shape, Work};
use pulp::{Arch, Simd, WithSimd};

/// Numbers between -size and size, about as many above 0 as below: with all below, Relu gives zeros
/// only.
fn numbers(seed: u64, count: usize, size: f64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        f64::from((state >> 32) as u32) / f64::from(u32::MAX >> 1) - 1.0
    };
    (0..count).map(|_| size * next()).collect()
}

fn linear(seed: u64, rows: usize, columns: usize) -> Layer {
    let weights = numbers(seed, rows * columns, 1.0 / (columns as f64).sqrt());
    Layer::Linear {
        columns,
        weights,
        bias: numbers(seed + 99, rows, 0.5),
    }
}

/// The network of a residual: normalised commands, two hidden layers of both kinds, an output in
/// mm.
fn layers() -> Vec<Layer> {
    vec![
        Layer::Shift(vec![-1.0, 2.0]),
        Layer::Scale(vec![0.1, 0.2]),
        linear(1, 9, 2),
        Layer::Normalise {
            epsilon: 1e-5,
            scale: numbers(2, 9, 1.5),
            shift: numbers(3, 9, 0.3),
        },
        Layer::Activation(Activation::Gelu),
        linear(4, 7, 9),
        Layer::Activation(Activation::Relu),
        linear(5, 6, 7),
        Layer::Scale(vec![3.0; 6]),
        Layer::Shift(numbers(6, 6, 20.0)),
    ]
}

/// The same, number by number.
fn plainly(layers: &[Layer], u: &[f64]) -> Vec<f64> {
    let mut x = u.to_vec();
    for layer in layers {
        x = match layer {
            Layer::Scale(by) => x.iter().zip(by).map(|(x, b)| x * b).collect(),
            Layer::Shift(by) => x.iter().zip(by).map(|(x, b)| x + b).collect(),
            Layer::Activation(Activation::Relu) => x.iter().map(|x| x.max(0.0)).collect(),
            Layer::Activation(Activation::Gelu) => x
                .iter()
                .map(|x| 0.5 * x * (1.0 + libm::erf(x / 2f64.sqrt())))
                .collect(),
            Layer::Linear {
                columns,
                weights,
                bias,
            } => {
                let rows = weights.chunks(*columns).zip(bias);
                rows.map(|(row, b)| row.iter().zip(&x).map(|(w, x)| w * x).sum::<f64>() + b)
                    .collect()
            }
            Layer::Normalise {
                epsilon,
                scale,
                shift,
            } => {
                let n = x.len() as f64;
                let mean = x.iter().sum::<f64>() / n;
                let spread = (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n
                    + f64::from(*epsilon))
                .sqrt();
                x.iter()
                    .zip(scale)
                    .zip(shift)
                    .map(|((x, s), t)| (x - mean) / spread * s + t)
                    .collect()
            }
        };
    }
    x
}

#[test]
fn values_are_those_of_plain_loops_one_at_a_time_and_side_by_side() {
    let network = Network::new(layers()).unwrap();
    let rows = numbers(7, 2 * 11, 12.0);
    let mut all = vec![0.0; 11 * 6];
    network.eval_rows(&rows, &mut all);
    for (k, u) in rows.chunks(2).enumerate() {
        let mut one = vec![0.0; 6];
        network.eval(u, &mut one);
        let truth = plainly(&layers(), u);
        for m in 0..6 {
            // Single precision of numbers of about 20.
            assert!((one[m] - truth[m]).abs() < 2e-5, "{} {}", one[m], truth[m]);
            assert!((all[6 * k + m] - truth[m]).abs() < 2e-5);
        }
    }
}

#[test]
fn slopes_are_those_of_differences() {
    let network = Network::new(layers()).unwrap();
    for u in numbers(8, 2 * 9, 12.0).chunks(2) {
        let mut slopes = [0.0; 12];
        network.jacobian(u, &mut slopes);
        assert!(slopes.iter().any(|slope| slope.abs() > 0.01));
        for c in 0..2 {
            let (mut above, mut below) = (u.to_vec(), u.to_vec());
            above[c] += 1e-5;
            below[c] -= 1e-5;
            let (above, below) = (plainly(&layers(), &above), plainly(&layers(), &below));
            for m in 0..6 {
                let wanted = (above[m] - below[m]) / 2e-5;
                assert!((slopes[2 * m + c] - wanted).abs() < 1e-5 * (1.0 + wanted.abs()));
            }
        }
    }
}

#[test]
fn many_channels_have_slopes_too() {
    let network = Network::new(vec![
        linear(1, 3, 17),
        Layer::Activation(Activation::Gelu),
        linear(2, 4, 3),
    ])
    .unwrap();
    let u = numbers(3, 17, 1.0);
    let mut slopes = [0.0; 4 * 17];
    network.jacobian(&u, &mut slopes);
    let mut value = [[0.0; 4]; 2];
    for c in 0..17 {
        let mut other = u.clone();
        for (side, step) in [0.01, -0.01].iter().enumerate() {
            other[c] = u[c] + step;
            network.eval(&other, &mut value[side]);
        }
        for m in 0..4 {
            assert!((slopes[17 * m + c] - (value[0][m] - value[1][m]) / 0.02).abs() < 1e-3);
        }
    }
}

#[test]
fn a_projected_network_is_the_network_seen_through_the_map() {
    let network = Network::new(layers()).unwrap();
    let (weights, offset) = (numbers(9, 6 * 2, 1.0), vec![1.0, -2.0]);
    let seen = network.project(&weights, &offset).unwrap();
    let (mut whole, mut part) = (vec![0.0; 6], vec![0.0; 2]);
    network.eval(&[3.0, 4.0], &mut whole);
    seen.eval(&[3.0, 4.0], &mut part);
    for m in 0..2 {
        let wanted: f64 = (0..6).map(|i| whole[i] * weights[2 * i + m]).sum::<f64>() + offset[m];
        assert!((part[m] - wanted).abs() < 1e-4);
    }
}

#[test]
fn what_does_not_fit_together_is_refused() {
    assert!(Network::new(vec![Layer::Activation(Activation::Relu)]).is_err());
    assert!(Network::new(vec![linear(1, 3, 2), linear(2, 4, 5)]).is_err());
    assert!(Network::new(vec![linear(1, 3, 2), Layer::Activation(Activation::Relu)]).is_err());
    assert!(Network::new(vec![Layer::Shift(vec![0.0; 3]), linear(1, 3, 2)]).is_err());
    for file in [&b"no file"[..], &[], &[0x3a, 0x00]] {
        assert!(Network::read(file).is_err());
    }
}

#[test]
fn the_bell_curve_is_that_of_double_precision() {
    for k in -12_000..=12_000 {
        let x = k as f32 * 1e-3;
        let wide = f64::from(x);
        let (below, density) = normal(x);
        let truth = 0.5 * (1.0 + libm::erf(wide / 2f64.sqrt()));
        let bell = (-0.5 * wide * wide).exp() / (2.0 * std::f64::consts::PI).sqrt();
        // Five units in the last place of 1, three of the density.
        assert!(
            (f64::from(below) - truth).abs() < 3e-7,
            "{x}: {below} {truth}"
        );
        assert!(
            (f64::from(density) - bell).abs() < 2e-7 * (bell + 0.1),
            "{x}"
        );
    }
    assert!((normal(f32::MAX).0 - 1.0).abs() < 3e-7 && normal(f32::MAX).1 < 1e-30);
    assert!(normal(f32::NAN).0.is_nan());
}

/// The widths of the published prior, to M outputs: 1.74 million numbers where M is 1644.
fn published(size: usize) -> Network {
    let widths = [2, 256, 512, 1024, 512, 256, size];
    let mut layers = vec![Layer::Shift(vec![1.0, -2.0]), Layer::Scale(vec![0.1; 2])];
    for (seed, pair) in widths.windows(2).enumerate() {
        if seed > 0 {
            layers.push(Layer::Activation(Activation::Relu));
        }
        layers.push(linear(seed as u64, pair[1], pair[0]));
    }
    Network::new(layers).unwrap()
}

#[test]
fn values_with_slopes_are_those_of_each() {
    for (network, count) in [(Network::new(layers()).unwrap(), 6), (published(300), 300)] {
        let (weights, offset) = (numbers(9, count * 3, 0.2), vec![1.0, -2.0, 3.0]);
        let tip = network.project(&weights, &offset).unwrap();
        for u in numbers(8, 2 * 9, 12.0).chunks(2) {
            let (mut values, mut slopes) = ([0.0; 3], [0.0; 6]);
            tip.with_slopes(u, &mut values, &mut slopes, &mut Work::default());
            let (mut value, mut slope) = ([0.0; 3], [0.0; 6]);
            tip.eval(u, &mut value);
            tip.jacobian(u, &mut slope);
            assert_eq!((values, slopes), (value, slope));
        }
    }
}

/// The allocations of this thread in every kind of pass: one command, a batch that is not a
/// multiple of the columns side by side, slopes, and both.
fn asked(network: &Network, values: &mut [f64], slopes: &mut [f64], rows: &[f64]) -> [usize; 4] {
    let (channels, size) = (network.channels(), network.size());
    let u = &rows[..channels];
    let mut work = Work::default();
    [
        allocations(|| network.eval(u, &mut values[..size])),
        allocations(|| network.eval_rows(rows, values)),
        allocations(|| network.jacobian(u, slopes)),
        allocations(|| network.with_slopes(u, &mut values[..size], slopes, &mut work)),
    ]
}

#[test]
fn no_pass_allocates_once_the_network_is_read() {
    let small = Network::new(layers()).unwrap();
    let whole = published(300);
    let tip = whole.project(&numbers(9, 300 * 3, 0.2), &[0.0; 3]).unwrap();
    let many = Network::new(vec![
        linear(1, 400, 17),
        Layer::Activation(Activation::Gelu),
        linear(2, 4, 400),
    ])
    .unwrap();
    for network in [&small, &whole, &tip, &many] {
        let rows = numbers(7, 13 * network.channels(), 12.0);
        let mut values = vec![0.0; 13 * network.size()];
        let mut slopes = vec![0.0; network.size() * network.channels()];
        assert_eq!(asked(network, &mut values, &mut slopes, &rows), [0; 4]);
        // Another thread allocates only in its first pass.
        let (first, later) = std::thread::scope(|scope| {
            let other = scope.spawn(|| {
                let first = asked(network, &mut values, &mut slopes, &rows);
                (first, asked(network, &mut values, &mut slopes, &rows))
            });
            other.join().unwrap()
        });
        assert_eq!((first, later), ([1, 0, 0, 0], [0; 4]));
    }
}

/// Every set of vectors that this processor has, from none on; `Arch::new` takes the last of them.
fn sets() -> Vec<Arch> {
    let mut sets = vec![Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    sets.extend(pulp::x86::V3::try_new().map(Arch::V3));
    #[cfg(target_arch = "aarch64")]
    sets.extend(pulp::aarch64::Neon::try_new().map(Arch::Neon));
    let chosen = Arch::new();
    if lanes(chosen) > sets.iter().map(|set| lanes(*set)).fold(0, usize::max) {
        sets.push(chosen);
    }
    sets
}

/// Numbers in one of its vectors.
fn lanes(set: Arch) -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    set.dispatch(Lanes)
}

#[test]
fn every_set_of_vectors_gives_the_same_and_the_widest_is_taken() {
    let sets = sets();
    let widths: Vec<usize> = sets.iter().map(|set| lanes(*set)).collect();
    assert_eq!(widths[0], 1);
    assert_eq!(
        widths.last(),
        Some(&lanes(Network::new(layers()).unwrap().arch))
    );
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        assert!(widths.contains(&8), "{widths:?}");
    }
    for (mut network, count) in [(Network::new(layers()).unwrap(), 6), (published(300), 300)] {
        let rows = numbers(7, 2 * 11, 12.0);
        let mut all: Vec<[Vec<f64>; 2]> = vec![];
        for set in &sets {
            network.arch = *set;
            let mut found = [vec![0.0; 11 * count], vec![0.0; 11 * 2 * count]];
            network.eval_rows(&rows, &mut found[0]);
            for (u, slopes) in rows.chunks(2).zip(found[1].chunks_mut(2 * count)) {
                network.jacobian(u, slopes);
            }
            all.push(found);
        }
        // Five layers of sums of up to a thousand numbers, in single precision: fused or not, in
        // another order.
        for found in &all[1..] {
            for (found, plain) in found.iter().zip(&all[0]) {
                let size = plain.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
                let apart = found.iter().zip(plain).map(|(a, b)| (a - b).abs());
                let apart = apart.fold(0.0, f64::max);
                assert!(apart < 1e-5 * size, "{apart} of {size}, {widths:?}");
            }
        }
    }
}
