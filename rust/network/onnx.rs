//! Reads the ONNX graphs that training exports, and no others: one chain of Gemm, Relu, Gelu and
//! LayerNormalization, with Sub, Div, Mul and Add of constants between them.
//!
//! The messages are those of onnx.proto3 (https://github.com/onnx/onnx), with the fields of such a
//! graph and those for external references ([`check`]). Anything else is rejected by name.

use super::{Activation, Layer};
use crate::error::{Result, invalid};
use prost::Message;
use std::collections::HashMap;

/// Most numbers of a network; the published one has 1.7 million.
const MOST_NUMBERS: usize = 16_000_000;
const FLOAT: i32 = 1;
/// The constant that the published layer normalisation adds to the variance.
const EPSILON: f32 = 1e-5;

#[derive(Message)]
struct Model {
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(bytes = "vec", repeated, tag = "25")]
    functions: Vec<Vec<u8>>,
}

#[derive(Message)]
struct Graph {
    #[prost(message, repeated, tag = "1")]
    node: Vec<Node>,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<Named>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<Named>,
    #[prost(bytes = "vec", repeated, tag = "15")]
    sparse_initializer: Vec<Vec<u8>>,
}

#[derive(Message)]
struct Named {
    #[prost(string, tag = "1")]
    name: String,
}

#[derive(Message)]
struct Node {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attribute: Vec<Attribute>,
    #[prost(string, tag = "7")]
    domain: String,
}

#[derive(Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(float, tag = "2")]
    f: f32,
    #[prost(int64, tag = "3")]
    i: i64,
    #[prost(bytes = "vec", tag = "4")]
    s: Vec<u8>,
    #[prost(message, optional, tag = "5")]
    t: Option<Tensor>,
    #[prost(bytes = "vec", optional, tag = "6")]
    g: Option<Vec<u8>>,
    #[prost(message, repeated, tag = "10")]
    tensors: Vec<Tensor>,
    #[prost(bytes = "vec", repeated, tag = "11")]
    graphs: Vec<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "22")]
    sparse_tensor: Option<Vec<u8>>,
    #[prost(bytes = "vec", repeated, tag = "23")]
    sparse_tensors: Vec<Vec<u8>>,
}

#[derive(Message)]
struct Tensor {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(float, repeated, tag = "4")]
    float_data: Vec<f32>,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
    #[prost(bytes = "vec", repeated, tag = "13")]
    external_data: Vec<Vec<u8>>,
    #[prost(int32, tag = "14")]
    data_location: i32,
}

/// Numbers of a constant, and its shape.
struct Constant {
    shape: Vec<usize>,
    numbers: Vec<f64>,
}

/// Rejects a file whose graph has external references, or may never end: weights in other files,
/// graphs within nodes (`Loop`, `If`, `Scan`), functions and operators of another domain than
/// ONNX's own. Any other graph runs each of its nodes once.
pub fn check(file: &[u8]) -> Result<()> {
    decode(file).map(|_| ())
}

fn decode(file: &[u8]) -> Result<Graph> {
    let model = Model::decode(file)
        .map_err(|error| invalid(format!("no ONNX file ({error}); export it again")))?;
    let graph = model
        .graph
        .ok_or_else(|| invalid("an ONNX file without a graph; export it again"))?;
    if !model.functions.is_empty() {
        return Err(invalid(
            "the graph defines functions, which are not read; export it without functions",
        ));
    }
    if !graph.sparse_initializer.is_empty() {
        return Err(sparse());
    }
    graph.initializer.iter().try_for_each(inside)?;
    graph.node.iter().try_for_each(simple)?;
    Ok(graph)
}

fn sparse() -> crate::error::Error {
    invalid("the graph holds sparse constants, which are not read; export dense ones")
}

/// Rejects a constant with its numbers in another file.
fn inside(tensor: &Tensor) -> Result<()> {
    if tensor.data_location == 0 && tensor.external_data.is_empty() {
        return Ok(());
    }
    Err(invalid(format!(
        "the numbers of '{:.80}' are in another file; export the graph with its weights in it \
        (save_as_external_data=False)",
        tensor.name
    )))
}

/// Rejects a node with its own graph, or one that is not an ONNX operator.
fn simple(node: &Node) -> Result<()> {
    if !matches!(&node.domain[..], "" | "ai.onnx") {
        return Err(invalid(format!(
            "the operator {:.40} is of the domain '{:.40}', only ONNX's own operators are read; \
            export it without it",
            node.op_type, node.domain
        )));
    }
    for attribute in &node.attribute {
        if attribute.g.is_some() || !attribute.graphs.is_empty() {
            return Err(invalid(format!(
                "the graph holds '{:.40}', a loop or branch that may never end; export a graph \
                without control flow",
                node.op_type
            )));
        }
        if attribute.sparse_tensor.is_some() || !attribute.sparse_tensors.is_empty() {
            return Err(sparse());
        }
        attribute
            .t
            .iter()
            .chain(&attribute.tensors)
            .try_for_each(inside)?;
    }
    Ok(())
}

/// The layers of a graph, in order.
pub fn layers(file: &[u8]) -> Result<Vec<Layer>> {
    let graph = decode(file)?;
    let constants = constants(graph.initializer)?;
    let inputs = graph.input.iter().map(|named| named.name.as_str());
    let inputs: Vec<&str> = inputs.filter(|n| !constants.contains_key(*n)).collect();
    let ([input], [output]) = (&inputs[..], &graph.output[..]) else {
        return Err(invalid(format!(
            "a graph of {} inputs and {} outputs; a prior or a residual has one of each",
            inputs.len(),
            graph.output.len()
        )));
    };
    let (mut at, mut found) = (*input, vec![]);
    for node in &graph.node {
        if node.input.first().map(String::as_str) != Some(at) || node.output.len() != 1 {
            return Err(invalid(format!(
                "the node {} of the graph does not follow on '{at}'; only a chain of layers is \
                read",
                node.op_type
            )));
        }
        found.push(layer(node, &constants)?);
        at = &node.output[0];
    }
    if at != output.name {
        return Err(invalid(format!(
            "the graph ends in '{at}', its output is '{}'; only a chain of layers is read",
            output.name
        )));
    }
    Ok(found)
}

/// The type of a tensor's numbers, by ONNX's element types.
fn type_name(data_type: i32) -> String {
    let names = [
        "uint8",
        "int8",
        "uint16",
        "int16",
        "int32",
        "int64",
        "strings",
        "bool",
        "float16",
        "float64",
        "uint32",
        "uint64",
        "complex64",
        "complex128",
        "bfloat16",
    ];
    let known = usize::try_from(data_type - 2)
        .ok()
        .and_then(|k| names.get(k));
    match *known.unwrap_or(&"") {
        "" => format!("numbers of an unknown type ({data_type})"),
        "strings" => "strings".into(),
        name => format!("{name} numbers"),
    }
}

fn constants(tensors: Vec<Tensor>) -> Result<HashMap<String, Constant>> {
    let (mut found, mut total) = (HashMap::new(), 0usize);
    for tensor in tensors {
        let name = tensor.name;
        let refuse = |why: String| {
            Err(invalid(format!(
                "constant '{name}': {why}; export it again"
            )))
        };
        if tensor.data_type != FLOAT {
            return Err(invalid(format!(
                "constant '{name}' holds {}; the core's network pass reads weights of 32-bit \
                floats alone",
                type_name(tensor.data_type)
            )));
        }
        let shape: Vec<usize> = tensor
            .dims
            .iter()
            .map(|d| usize::try_from(*d).unwrap_or(usize::MAX))
            .collect();
        let count = shape
            .iter()
            .try_fold(1usize, |n, d| n.checked_mul(*d))
            .unwrap_or(usize::MAX);
        total = total.saturating_add(count);
        if total > MOST_NUMBERS {
            return refuse(format!(
                "more than {MOST_NUMBERS} numbers with those before"
            ));
        }
        let raw = tensor.raw_data.chunks_exact(4);
        let odd = !raw.remainder().is_empty();
        let numbers: Vec<f64> = if tensor.raw_data.is_empty() {
            tensor.float_data.iter().map(|v| f64::from(*v)).collect()
        } else {
            raw.map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])))
                .collect()
        };
        if numbers.len() != count || odd {
            return refuse(format!("{} numbers for the shape {shape:?}", numbers.len()));
        }
        if !numbers.iter().all(|v| v.is_finite()) {
            return refuse("not all numbers are finite".into());
        }
        found.insert(name, Constant { shape, numbers });
    }
    Ok(found)
}

fn layer(node: &Node, constants: &HashMap<String, Constant>) -> Result<Layer> {
    let constant = |place: usize| {
        node.input
            .get(place)
            .and_then(|n| constants.get(n))
            .ok_or_else(|| {
                invalid(format!(
                    "{}: its input {place} is no constant; only a chain of layers is read",
                    node.op_type
                ))
            })
    };
    let vector = |place: usize| constant(place).map(|c| c.numbers.clone());
    let number = |name: &str, usual: f32| {
        node.attribute
            .iter()
            .find(|a| a.name == name)
            .map_or(usual, |a| a.f)
    };
    let whole = |name: &str, usual: i64| {
        node.attribute
            .iter()
            .find(|a| a.name == name)
            .map_or(usual, |a| a.i)
    };
    let refuse = |why: &str| {
        Err(invalid(format!(
            "{}: {why}; export it with softmap-training",
            node.op_type
        )))
    };
    match node.op_type.as_str() {
        "Gemm" => {
            if number("alpha", 1.0) != 1.0
                || number("beta", 1.0) != 1.0
                || whole("transA", 0) != 0
                || whole("transB", 0) != 1
            {
                return refuse("expected alpha 1, beta 1, transA 0 and transB 1");
            }
            let weights = constant(1)?;
            let [rows, columns] = weights.shape[..] else {
                return refuse("its weights are no matrix");
            };
            let bias = vector(2)?;
            if bias.len() != rows {
                return refuse("as many numbers in its bias as rows in its weights are needed");
            }
            Ok(Layer::Linear {
                columns,
                weights: weights.numbers.clone(),
                bias,
            })
        }
        "Relu" => Ok(Layer::Activation(Activation::Relu)),
        "Gelu"
            if node
                .attribute
                .iter()
                .all(|a| a.name != "approximate" || a.s == b"none") =>
        {
            Ok(Layer::Activation(Activation::Gelu))
        }
        "Gelu" => refuse("only the exact one is read"),
        "LayerNormalization" if !matches!(whole("axis", -1), -1 | 1) => {
            refuse("expected the last axis")
        }
        "LayerNormalization" => Ok(Layer::Normalise {
            epsilon: number("epsilon", EPSILON),
            scale: vector(1)?,
            shift: vector(2)?,
        }),
        "Sub" => Ok(Layer::Shift(vector(1)?.iter().map(|v| -v).collect())),
        "Add" => Ok(Layer::Shift(vector(1)?)),
        "Mul" => Ok(Layer::Scale(vector(1)?)),
        "Div" => {
            let by = vector(1)?;
            if by.contains(&0.0) {
                return refuse("it divides by zero");
            }
            Ok(Layer::Scale(by.iter().map(|v| 1.0 / v).collect()))
        }
        other => Err(invalid(format!(
            "the graph holds '{other:.40}', read are Gemm, Relu, Gelu, LayerNormalization, Sub, \
             Div, Mul, Add; export it with softmap-training"
        ))),
    }
}
