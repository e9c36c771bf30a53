// Arguments and results of completions on the calling thread and on a worker.

/** Weights of the package, the address of a weights file, or its contents. */
export type Weights = "default" | "small" | URL | ArrayBuffer | Uint8Array;

export interface LoadOptions {
  /** "default" (7.1 MB) or "small" (2.3 MB, two thirds of the time, less accurate) of this package, or others of lsdc. */
  readonly weights?: Weights;
}

export interface SceneOptions {
  /** "best": the mean of the completions of the image and of its mirror image, in twice the time and memory. */
  readonly quality?: "standard" | "best";
}

/** Settings of a fit, with the names of `lsdc complete`. Missing or null: as stored with the weights. */
export interface FitOptions {
  readonly fit?: "joint" | "lse" | "field" | null;
  readonly robust?: "none" | "auto" | "huber" | "cauchy" | "gm" | "tukey" | "irls" | null;
  readonly prior?: "learned" | "flat" | "none" | null;
  /** Standard deviation, in metres, of points that have none. */
  readonly sigma?: number | null;
  /** Noise of a depth camera for points without a standard deviation: "kinect", "realsense", "tof", or "A,B,C". */
  readonly noise?: string | null;
}

export interface CompleteOptions extends FitOptions {
  /** Numbers per point in a typed array: u, v, depth and, with 4, sigma [default: 3]. */
  readonly columns?: 3 | 4;
  /** Whether to compute the standard deviation of every pixel [default: true]. */
  readonly deviations?: boolean;
  /** Whether to compute leave-one-out errors and test points for outliers [default: true]. */
  readonly outliers?: boolean;
}

/** A point that is more likely an outlier than an inlier. */
export interface Outlier {
  /** The index of the point. */
  readonly index: number;
  readonly probability: number;
  /** Its depth minus the prediction from the others, over the scale of the errors of inliers; positive if farther away. */
  readonly score: number;
  /** Its depth minus the prediction from the others, in metres. */
  readonly error: number;
  /** Its weight in the fit. */
  readonly weight: number;
}

/** Numbers of a completion, with the names of `lsdc complete --json`; metres, seconds. */
export interface Report {
  readonly points: {
    readonly given: number;
    readonly used: number;
    /** Points with an unusable depth or position. */
    readonly ignored: number;
    /** Points outside the image. */
    readonly outside: number;
    /** Points used without a standard deviation, if others have one. */
    readonly without_deviation: number;
  };
  readonly depth: { readonly lowest: number; readonly highest: number; readonly clamped: number } | null;
  readonly fit: {
    readonly method: "joint" | "lse" | "field";
    /** Root mean square of the residuals. */
    readonly residual: number;
    /** Root mean square of the leave-one-out errors, an estimate of the error between the points. */
    readonly leave_one_out: number | null;
    readonly outliers: number | null;
    /** Number of standard deviations that contain 95 % of errors. */
    readonly deviations_of_95: number | null;
    readonly smoothed: number;
    readonly limited: number;
    readonly rank: number;
    readonly functions: number;
    readonly median_share: number | null;
  };
  readonly seconds: {
    /** The network, once for a scene. */
    readonly network: number;
    /** The fit and all outputs. */
    readonly completion: number;
  };
  /** Outputs that could not be computed, and why. */
  readonly remarks: readonly string[];
}

export interface Completion {
  readonly width: number;
  readonly height: number;
  /** The depth of every pixel in metres, row by row. */
  readonly depth: Float32Array;
  /** Its standard deviation in metres; null if it was not requested, or cannot be computed (see `report.remarks`). */
  readonly deviations: Float32Array | null;
  /** Worst first; null if points were not tested. */
  readonly outliers: readonly Outlier[] | null;
  /** The depth of every point minus the map, in metres; NaN for points that were not used. */
  readonly residuals: Float32Array;
  /** The depth of every point minus a map fitted to the others, in metres; null if points were not tested. */
  readonly leaveOneOut: Float32Array | null;
  readonly report: Report;
}
