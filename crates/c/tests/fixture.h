// A completion and its inputs.

#ifndef FIXTURE_H
#define FIXTURE_H

#include "check.h"

static uint8_t rgb[3 * PIXELS];
static double xs[100], ys[100];
static float depths[100];
static float sparse[PIXELS], dense[PIXELS];

static lsdc_completer *completer;
static lsdc_scene *scene;
static lsdc_completion *completion;

static inline void prepare(void) {
    uint64_t random = 1;
    paint(rgb, WIDTH, HEIGHT, 7);
    for (int i = 0; i < 100; ++i) {
        xs[i] = uniform(&random) * (WIDTH - 1);
        ys[i] = uniform(&random) * (HEIGHT - 1);
        depths[i] = xs[i] < WIDTH / 2 ? 2.0f : 3.0f;
    }
    for (int i = 0; i < PIXELS; i += 17) sparse[i] = i % WIDTH < WIDTH / 2 ? 2.0f : 3.0f;
    lsdc_completer_options options = quick();
    lsdc_image image = image_of(rgb, WIDTH, HEIGHT);
    lsdc_points points = points_of(xs, ys, depths, 100);
    OK(lsdc_completer_create("small", &options, &completer));
    OK(lsdc_scene_create(completer, &image, NULL, &scene));
    OK(lsdc_scene_complete(scene, &points, NULL, &completion));
}

static inline void release(void) {
    OK(lsdc_completion_free(completion));
    OK(lsdc_scene_free(scene));
    OK(lsdc_completer_free(completer));
}

#endif
