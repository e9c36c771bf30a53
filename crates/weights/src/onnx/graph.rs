//! Nodes and constants of a graph under construction. A value is the name of a node's output.

use super::proto::{Attribute, Constant, GraphBody, Node, ValueInfo, attribute, element};

#[derive(Debug, Default)]
pub(super) struct Graph {
    nodes: Vec<Node>,
    constants: Vec<Constant>,
}

/// Axes of rows and columns in `[batch, channels, height, width]`.
pub(super) const ROWS: i64 = 2;
pub(super) const COLUMNS: i64 = 3;

pub(super) fn int(name: &str, value: i64) -> Attribute {
    Attribute {
        name: name.to_owned(),
        i: Some(value),
        kind: attribute::INT,
        ..Attribute::default()
    }
}

pub(super) fn ints(name: &str, values: &[i64]) -> Attribute {
    Attribute {
        name: name.to_owned(),
        ints: values.to_vec(),
        kind: attribute::INTS,
        ..Attribute::default()
    }
}

fn text(name: &str, value: &str) -> Attribute {
    Attribute {
        name: name.to_owned(),
        s: Some(value.to_owned()),
        kind: attribute::STRING,
        ..Attribute::default()
    }
}

impl Graph {
    /// Adds a node with one output.
    pub(super) fn node(
        &mut self,
        operator: &str,
        inputs: &[&str],
        attributes: impl Into<Vec<Attribute>>,
    ) -> String {
        let name = format!("{operator}_{}", self.nodes.len());
        self.nodes.push(Node {
            input: inputs.iter().map(ToString::to_string).collect(),
            output: vec![name.clone()],
            name: name.clone(),
            op_type: operator.to_owned(),
            attribute: attributes.into(),
        });
        name
    }

    /// Adds a node without attributes.
    pub(super) fn apply(&mut self, operator: &str, inputs: &[&str]) -> String {
        self.node(operator, inputs, Vec::new())
    }

    pub(super) fn concat(&mut self, inputs: &[&str], axis: i64) -> String {
        self.node("Concat", inputs, [int("axis", axis)])
    }

    /// Adds a named constant of floats.
    pub(super) fn floats(&mut self, name: String, shape: &[usize], values: &[f32]) -> String {
        let data = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, shape, element::FLOAT, data)
    }

    /// Adds a scalar constant.
    pub(super) fn scalar(&mut self, value: f32) -> String {
        let name = format!("constant_{}", self.constants.len());
        self.floats(name, &[], &[value])
    }

    /// Adds a constant list of integers.
    pub(super) fn indices(&mut self, values: &[i64]) -> String {
        let name = format!("constant_{}", self.constants.len());
        let data = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, &[values.len()], element::INT64, data)
    }

    fn constant(
        &mut self,
        name: String,
        shape: &[usize],
        data_type: i32,
        raw_data: Vec<u8>,
    ) -> String {
        self.constants.push(Constant {
            dims: shape.iter().map(|&side| side as i64).collect(),
            data_type,
            name: name.clone(),
            raw_data,
        });
        name
    }

    /// Slices a value along an axis; `end` may be `i64::MAX`.
    pub(super) fn slice(&mut self, x: &str, axis: i64, start: i64, end: i64) -> String {
        let [start, end, axis] = [start, end, axis].map(|value| self.indices(&[value]));
        self.apply("Slice", &[x, &start, &end, &axis])
    }

    /// Returns the lengths of the axes from `start` until `end`.
    pub(super) fn lengths(&mut self, x: &str, start: i64, end: i64) -> String {
        let shape = self.apply("Shape", &[x]);
        self.slice(&shape, 0, start, end)
    }

    /// Returns height and width.
    pub(super) fn size(&mut self, x: &str) -> String {
        self.lengths(x, ROWS, COLUMNS + 1)
    }

    /// Resizes by bilinear interpolation between pixel centres.
    pub(super) fn resize(&mut self, x: &str, size: &str) -> String {
        let kept = self.lengths(x, 0, ROWS);
        let sizes = self.concat(&[&kept, size], 0);
        let attributes = [
            text("mode", "linear"),
            text("coordinate_transformation_mode", "half_pixel"),
        ];
        // Neither a region nor scales.
        self.node("Resize", &[x, "", "", &sizes], attributes)
    }

    /// Renames a value to an output of the graph.
    pub(super) fn rename(&mut self, value: &str, name: &str) {
        for node in &mut self.nodes {
            let all = node.input.iter_mut().chain(&mut node.output);
            all.filter(|known| *known == value)
                .for_each(|known| name.clone_into(known));
        }
    }

    pub(super) fn finish(self, input: Vec<ValueInfo>, output: Vec<ValueInfo>) -> GraphBody {
        GraphBody {
            node: self.nodes,
            name: "lsdc".to_owned(),
            initializer: self.constants,
            input,
            output,
        }
    }
}
