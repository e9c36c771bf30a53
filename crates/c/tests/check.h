// Shared by the tests, which are valid C11 and C++17.

#ifndef CHECK_H
#define CHECK_H

#include <lsdc.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "%s:%d: %s\nlast error: %s\n", __FILE__, __LINE__, #condition, lsdc_last_error()); \
            exit(EXIT_FAILURE);                                                                              \
        }                                                                                                    \
    } while (0)

#define OK(call) CHECK((call) == LSDC_OK)

// Checks that a call fails with this status and a message that contains this text.
#define FAILS(status, text, call)                                                                            \
    do {                                                                                                     \
        CHECK((call) == (status));                                                                           \
        CHECK(strstr(lsdc_last_error(), text) != NULL);                                                      \
    } while (0)

enum { WIDTH = 48, HEIGHT = 32, PIXELS = WIDTH * HEIGHT };

// Steele and others: Fast splittable pseudorandom number generators, 2014.
static inline uint64_t next_random(uint64_t *state) {
    uint64_t z = *state += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

static inline double uniform(uint64_t *state) { return (double)(next_random(state) >> 11) * 0x1p-53; }

// Paints two walls with noise.
static inline void paint(uint8_t *rgb, size_t width, size_t height, uint64_t seed) {
    for (size_t i = 0; i < 3 * width * height; ++i) {
        rgb[i] = (uint8_t)((i / 3 % width < width / 2 ? 60 : 160) + next_random(&seed) % 20);
    }
}

static inline lsdc_image image_of(const void *data, size_t width, size_t height) {
    lsdc_image image;
    memset(&image, 0, sizeof image);
    image.struct_size = sizeof image;
    image.data = data;
    image.size = 3 * width * height;
    image.width = width;
    image.height = height;
    image.format = LSDC_RGB8;
    return image;
}

static inline lsdc_map map_of(const float *data, size_t width, size_t height) {
    lsdc_map map;
    memset(&map, 0, sizeof map);
    map.struct_size = sizeof map;
    map.data = data;
    map.size = width * height * sizeof *data;
    map.width = width;
    map.height = height;
    map.format = LSDC_F32;
    return map;
}

static inline lsdc_points points_of(const double *x, const double *y, const float *depth, size_t count) {
    lsdc_points points;
    memset(&points, 0, sizeof points);
    points.struct_size = sizeof points;
    points.count = count;
    points.x = x;
    points.y = y;
    points.depth = depth;
    return points;
}

// Settings with which the network runs in milliseconds.
static inline lsdc_completer_options quick(void) {
    lsdc_completer_options options;
    memset(&options, 0, sizeof options);
    options.struct_size = sizeof options;
    options.threads = 2;
    options.working_width = 32;
    options.working_height = 24;
    return options;
}

#endif
