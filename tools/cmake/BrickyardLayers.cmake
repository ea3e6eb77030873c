# A layer sees its own headers and those below it, nothing above: each layer's include path is a folder of its own with
# one link in it, so `#include "server/..."` in core or client finds no file.

# brickyard_layer(core SOURCES a.cpp a.h DEPENDS brickyard::proto ...) makes the target brickyard::core.
function(brickyard_layer name)
    cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
    set(root ${PROJECT_BINARY_DIR}/layers/${name})
    file(MAKE_DIRECTORY ${root})
    file(CREATE_LINK ${PROJECT_SOURCE_DIR}/${name} ${root}/${name} SYMBOLIC)
    add_library(brickyard_${name} STATIC ${ARG_SOURCES})
    add_library(brickyard::${name} ALIAS brickyard_${name})
    target_include_directories(brickyard_${name} PUBLIC ${root})
    target_link_libraries(brickyard_${name} PUBLIC ${ARG_PUBLIC} PRIVATE brickyard::warnings ${ARG_PRIVATE})
endfunction()
