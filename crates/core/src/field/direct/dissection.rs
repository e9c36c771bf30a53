//! Nested dissection: the order in which the pixels of a grid are eliminated.

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Region {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

/// The order of elimination.
#[derive(Debug)]
pub(super) struct Dissection {
    width: usize,
    /// When each pixel's own line or leaf is reached.
    turns: Vec<u32>,
}

/// Regions of at most this many pixels are not cut further.
const LEAF: usize = 64;

impl Region {
    pub(super) fn whole(height: usize, width: usize) -> Self {
        Self {
            left: 0,
            top: 0,
            width,
            height,
        }
    }

    pub(super) fn area(self) -> usize {
        self.width * self.height
    }

    /// Two halves, and the line of pixels between them.
    pub(super) fn cut(self) -> Option<([Self; 2], Self)> {
        if self.area() <= LEAF || self.width.max(self.height) < 3 {
            return None;
        }
        Some(if self.width >= self.height {
            let half = self.width / 2;
            let part = |left, width| Self {
                left: self.left + left,
                width,
                ..self
            };
            let after = part(half + 1, self.width - half - 1);
            ([part(0, half), after], part(half, 1))
        } else {
            let half = self.height / 2;
            let part = |top, height| Self {
                top: self.top + top,
                height,
                ..self
            };
            let after = part(half + 1, self.height - half - 1);
            ([part(0, half), after], part(half, 1))
        })
    }

    fn pixels(self, width: usize) -> impl Iterator<Item = u32> {
        let rows = self.top..self.top + self.height;
        rows.flat_map(move |y| {
            let start = (y * width + self.left) as u32;
            start..start + self.width as u32
        })
    }
}

impl Dissection {
    pub(super) fn new(height: usize, width: usize) -> Self {
        let mut cuts = Self {
            width,
            turns: vec![0; height * width],
        };
        cuts.number(Region::whole(height, width), 0);
        cuts
    }

    /// Numbers a region from `turn` on, and returns the next turn.
    fn number(&mut self, region: Region, turn: u32) -> u32 {
        let (own, turn) = match region.cut() {
            None => (region, turn),
            Some(([one, two], line)) => {
                let turn = self.number(one, turn);
                (line, self.number(two, turn))
            }
        };
        for pixel in own.pixels(self.width) {
            self.turns[pixel as usize] = turn;
        }
        turn + 1
    }

    pub(super) fn turn(&self, pixel: u32) -> u32 {
        self.turns[pixel as usize]
    }

    pub(super) fn pixels(&self, region: Region) -> impl Iterator<Item = u32> {
        region.pixels(self.width)
    }

    pub(super) fn len(&self) -> usize {
        self.turns.len()
    }
}
