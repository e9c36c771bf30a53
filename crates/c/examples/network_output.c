// Fits the output of a network that another program runs, such as ONNX Runtime with the graph of `lsdc weights export NAME
// --onnx FILE`. Here, the other program reads and writes files of floats:
//
//     network_output input IMAGE.ppm INPUT.f32                             for the input `image` of the graph
//     network_output complete IMAGE.ppm SPARSE.npy BASIS.f32 AFFINITIES.f32 DEPTH.npy
//
// The weights are "small".

#include "files.h"
#include <lsdc.h>

static void check(lsdc_status status) {
    if (status == LSDC_OK) return;
    fprintf(stderr, "lsdc: %s\n", lsdc_last_error());
    if (*lsdc_last_hint()) fprintf(stderr, "hint: %s\n", lsdc_last_hint());
    exit(EXIT_FAILURE);
}

// Reads all floats of a file; `*count` is their number.
static float *read_floats(const char *path, size_t *count) {
    FILE *file = fopen(path, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) file_error(path, "cannot be opened");
    long bytes = ftell(file);
    if (bytes < 0 || bytes % (long)sizeof(float) != 0) file_error(path, "does not hold floats");
    rewind(file);
    *count = (size_t)bytes / sizeof(float);
    float *values = (float *)allocated(path, (size_t)bytes);
    if (fread(values, sizeof *values, *count, file) != *count) file_error(path, "cannot be read");
    fclose(file);
    return values;
}

static void write_floats(const char *path, const float *values, size_t count) {
    FILE *file = fopen(path, "wb");
    if (file == NULL) file_error(path, "cannot be written");
    size_t whole = fwrite(values, sizeof *values, count, file) == count;
    if (fclose(file) != 0 || !whole) file_error(path, "cannot be written");
}

int main(int count, char **arguments) {
    int writes = count == 4 && strcmp(arguments[1], "input") == 0;
    if (!writes && (count != 7 || strcmp(arguments[1], "complete") != 0)) {
        fprintf(stderr,
                "usage: %s input IMAGE.ppm INPUT.f32\n"
                "       %s complete IMAGE.ppm SPARSE.npy BASIS.f32 AFFINITIES.f32 DEPTH.npy\n",
                arguments[0], arguments[0]);
        return EXIT_FAILURE;
    }
    size_t width, height, columns, rows;
    uint8_t *rgb = read_ppm(arguments[2], &width, &height);
    lsdc_image image = {
        .struct_size = sizeof image,
        .data = rgb,
        .size = 3 * width * height,
        .width = width,
        .height = height,
        .format = LSDC_RGB8,
    };
    // Use the prior and the fit settings of the exported network.
    lsdc_completer *completer;
    check(lsdc_completer_create("small", NULL, &completer));
    check(lsdc_completer_network_size(completer, width, height, &columns, &rows));

    if (writes) {
        size_t values = 3 * columns * rows;
        float *input = (float *)allocated(arguments[3], values * sizeof *input);
        check(lsdc_completer_network_input(completer, &image, input, values * sizeof *input));
        write_floats(arguments[3], input, values);
        printf("1 x 3 x %zu x %zu\n", rows, columns);
        free(input);
    } else {
        size_t functions, affinities;
        float *sparse = read_npy(arguments[3], width, height);
        lsdc_network_output output = {.struct_size = sizeof output, .width = columns, .height = rows};
        float *basis = read_floats(arguments[4], &functions), *pairs = read_floats(arguments[5], &affinities);
        if (functions % (columns * rows) != 0) file_error(arguments[4], "has another size");
        if (affinities != 2 * columns * rows) file_error(arguments[5], "has another size");
        output.basis = basis;
        output.affinities = pairs;
        output.functions = functions / (columns * rows);

        lsdc_scene_options options = {.struct_size = sizeof options, .output = &output};
        lsdc_scene *scene;
        check(lsdc_scene_create(completer, &image, &options, &scene));
        free(basis);
        free(pairs);
        lsdc_map map = {
            .struct_size = sizeof map,
            .data = sparse,
            .size = width * height * sizeof *sparse,
            .width = width,
            .height = height,
            .format = LSDC_F32,
        };
        lsdc_completion *completion;
        check(lsdc_scene_complete_map(scene, &map, NULL, NULL, &completion));
        check(lsdc_completion_depth(completion, width, height, sparse, map.size, 0));
        write_npy(arguments[6], sparse, width, height);
        lsdc_completion_free(completion);
        lsdc_scene_free(scene);
        free(sparse);
    }
    lsdc_completer_free(completer);
    free(rgb);
    return EXIT_SUCCESS;
}
